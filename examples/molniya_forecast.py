"""How far is a forecast of a Molniya orbit to be trusted? `python examples/molniya_forecast.py`."""

import matplotlib.pyplot as plt
import torch
from scipy.integrate import solve_ivp

import ahnn

MU, RADIUS, J2 = 398600.4418, 6378.1363, 1.0826e-3  # km^3/s^2, km


def oblate(_, x):
    """Newton's law with the Earth's oblateness (Vallado 2013, eq. 8-25)."""
    q, r2 = x[:3], x[:3] @ x[:3]
    bulge = 1.5 * J2 * RADIUS**2 / r2
    factor = [1 + bulge * (k - 5 * q[2] ** 2 / r2) for k in (1, 1, 3)]
    return [*x[3:], *(-MU * q / r2**1.5 * factor)]


run = ahnn.load("molniya_mechanical")
perigee = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]  # km, km/s
times = torch.arange(0.0, 86_401.0, 300.0, dtype=torch.float64)
forecast = run.predict(perigee, times, start_sd=[0.1, 1e-4])  # known to 100 m and 10 cm/s
spread = forecast.covariances[0, :, :3, :3].diagonal(dim1=-2, dim2=-1).sum(-1).sqrt()

draws = torch.tensor(perigee) + torch.tensor([0.1] * 3 + [1e-4] * 3) * torch.randn(
    20, 6, generator=torch.Generator().manual_seed(1)
)
errors = []
for draw in draws.double():  # where the satellite may really have begun
    exact = solve_ivp(oblate, (0, 86_400), draw, "DOP853", times.numpy(), rtol=1e-11, atol=1e-9).y.T
    errors.append((torch.from_numpy(exact) - forecast.states[0])[:, :3].norm(dim=1))
errors = torch.stack(errors)  # (20, T)
rms = errors.square().mean(0).sqrt()
print(f"after a day: forecast deviation {spread[-1]:.1f} km, rms of 20 true orbits {rms[-1]:.1f} km")

figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
hours = times / 3600
axes.semilogy(hours, errors.T, color="0.7", lw=0.7)
axes.plot([], [], color="0.7", label="error against 20 true orbits (SciPy)")
axes.plot(hours, rms, color="k", ls="--", label="their rms")
axes.plot(hours, spread, color="#D55E00", lw=2, label="standard deviation of the forecast")
axes.set(xlabel="time [h]", ylabel="position [km]", xlim=(0, 24), ylim=(0.03, 3e3))
axes.set_title("Molniya orbit, start known to 100 m and 10 cm/s per axis")
axes.grid(alpha=0.3)
axes.legend(loc="upper left")
figure.savefig("molniya_forecast.png", dpi=100)
