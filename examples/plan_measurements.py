"""When should four position fixes be taken? `python examples/plan_measurements.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.prediction.measurement_plan import evenly_spaced, plan_measurements, variance_with
from ahnn.prediction.propagation import prediction_factors

DAY, SD, COUNT = 86_400.0, 0.1, 4  # s; km
run = ahnn.load("molniya_mechanical")
perigee = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]  # km, km/s
start = run.predict(perigee, [0.0, 4 * 3600.0]).states[0, 1]  # four hours later
prior = torch.tensor([1.0] * 3 + [1e-3] * 3, dtype=torch.float64).square().diag()  # known to 1 km and 1 m/s
times = torch.cat((torch.arange(0.0, DAY + 1, 1800.0), torch.tensor([3 * DAY]))).double()
states, factors = prediction_factors(run.dynamics, start, times, run.dt, run.knowledge(prior))

candidates = [one[:3] / SD for one in factors[:-1]]  # a fix at each half hour of the first day
forecast = factors[-1, :3]  # the position after three days
plan = plan_measurements(candidates, forecast, COUNT)
spacing = [
    float(variance_with([candidates[k] for k in evenly_spaced(len(candidates), count)], forecast).sqrt())
    for count in range(1, COUNT + 1)
]
planned = plan.variances.sqrt()
hours = times / 3600
print("fixes at", ", ".join(f"{hours[k]:g} h" for k in plan.chosen))
print(
    f"forecast: {planned[0]:.0f} km before, {planned[-1]:.2f} km planned, {spacing[-1]:.2f} km evenly spaced"
)

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
radius = states[:-1, :3].norm(dim=1) / 1000
left.plot(hours[:-1], radius, color="0.5")
left.plot(hours[:-1][plan.chosen], radius[plan.chosen], "o", color="#D55E00")
for order, k in enumerate(plan.chosen, 1):
    left.annotate(str(order), (hours[k], radius[k]), (4, 4), textcoords="offset points")
left.set(xlabel="time [h]", ylabel="distance from the Earth's centre [1000 km]", title="Chosen fixes")
right.semilogy(range(COUNT + 1), planned, "o-", color="#D55E00", label="planned")
right.semilogy(range(1, COUNT + 1), spacing, "s--", color="#0072B2", label="evenly spaced")
right.set(
    xlabel="fixes of 100 m",
    ylabel="standard deviation after three days [km]",
    title="Forecast of the position",
)
right.grid(alpha=0.3)
right.legend()
figure.savefig("plan_measurements.png", dpi=100)
