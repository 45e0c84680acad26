"""Which orbit do the sightings of three stations determine? `python examples/orbit_determination.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.estimation import initial_belief
from ahnn.measurements import GroundStation, Several, observe
from ahnn.rollouts import rollout
from ahnn.systems import Molniya, exact_flow
from ahnn.tracking.initial_orbit import gibbs
from ahnn_plugins.ukf import batch_least_squares

run = ahnn.load("molniya_mechanical")
DT, STEPS = 600.0, 48  # s; 8 hours
flow = exact_flow(Molniya(name="molniya", dt=60.0, steps=10))  # point mass and J2
perigee = torch.tensor([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]], dtype=torch.float64)  # km, km/s
truth = rollout(flow, perigee, DT, STEPS + 5, longest=60.0)[:, 4:]  # from 40 minutes after perigee

places = {"Kiruna": (67.9, 21.0), "Fairbanks": (64.9, -147.7), "Svalbard": (78.2, 15.4)}
stations = Several([GroundStation(*place, min_elevation=10.0) for place in places.values()])
times = DT * torch.arange(STEPS + 1, dtype=torch.float64)
exact = torch.stack([observe(stations, truth[:, k], times[k]) for k in range(STEPS + 1)], dim=1)
sd = torch.tensor(3 * [0.05, 3e-4, 3e-4], dtype=torch.float64)  # range in km, azimuth and elevation in rad
noise = torch.randn(exact.shape, generator=torch.Generator().manual_seed(1)).double()
seen = exact + sd * noise  # NaN below 10 degrees


def learned(x, dt):
    for _ in range(10):  # steps of a minute, as in the training
        x = run.dynamics(x, dt / 10)
    return x


located = stations.locate(seen[0], times)  # (T, 3), mean over the stations in view
first, middle, last = located.isfinite().all(1).nonzero().flatten()[[0, 9, 18]].tolist()
velocity = gibbs(located[[first, middle, last]].numpy())
guess = torch.cat((located[middle], torch.from_numpy(velocity))).unsqueeze(0)
guess = rollout(learned, guess, -DT, middle + 1)[:, -1]  # back to the start
prior = initial_belief(guess, torch.diag(torch.tensor([300.0] * 3 + [0.3] * 3).double() ** 2))
fit = batch_least_squares(learned, prior, seen[:, 1:], stations, torch.diag(sd**2), DT)

errors = {}
for name, begin in (("Gibbs, three positions", guess), ("least squares, all sightings", fit.initial.mean)):
    path = rollout(learned, begin, DT, STEPS + 1)
    errors[name] = (path - truth)[0, :, :3].norm(dim=1)
count = int(fit.measured.sum())
print(f"{count} numbers, chi-square {float(fit.cost):.0f}")
print({name: f"{float(error[0]):.3g} km at the start" for name, error in errors.items()})

hours = times / 3600
spread = fit.chols[0, :, :3].square().sum((1, 2)).sqrt()
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
left.plot(*truth[0, :, [0, 2]].T / 1000, "k-", lw=1)
left.plot(*located[:, [0, 2]].T / 1000, ".", color="#56B4E9", label="located by the stations")
left.plot(
    *located[[first, middle, last]][:, [0, 2]].T / 1000,
    "o",
    color="#D55E00",
    label="three of them, for Gibbs",
)
left.add_patch(plt.Circle((0, 0), 6.378, color="0.8"))
left.set(xlabel="x [1000 km]", ylabel="z [1000 km]", aspect="equal", title="Eight hours of sightings")
left.set(xlim=(-34, 34), ylim=(-22, 46))
left.legend(fontsize="small", loc="lower center")
for (name, error), colour in zip(errors.items(), ("#D55E00", "#0072B2"), strict=True):
    right.semilogy(hours, error, color=colour, label=name)
right.plot(hours[1:], spread, "k--", lw=1, label="its standard deviation")
right.set(xlabel="time [h]", ylabel="position error [km]", xlim=(0, 8), title="Determined orbits")
right.grid(alpha=0.3)
right.legend(fontsize="small")
figure.savefig("orbit_determination.png", dpi=100)
