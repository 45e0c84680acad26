"""What does a CSV of noisy angles say about the motion to come? `python examples/noisy_csv.py`."""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from scipy.integrate import solve_ivp

import ahnn

SD = 0.02  # rad
folder, draw = Path(tempfile.mkdtemp()), np.random.default_rng(1)
times = np.arange(0, 4.05, 0.1)


def swing(angle, t):
    """Return the angle of a pendulum of 1 m that is let go."""
    pull = lambda _, x: [x[1], -9.81 * np.sin(x[0])]  # noqa: E731
    return solve_ivp(pull, (0, t[-1]), [angle, 0.0], "DOP853", t, rtol=1e-10, atol=1e-10).y[0]


angles = np.stack([swing(a, times) for a in draw.uniform(0.3, 2.0, 30)])
noisy = angles + SD * draw.normal(size=angles.shape)
rows = np.stack((np.arange(30).repeat(len(times)), np.tile(times, 30), noisy.ravel()), axis=1)
np.savetxt(folder / "swings.csv", rows, "%d,%.1f,%.5f", header="id,t [s],angle [rad]", comments="")

table = np.loadtxt(folder / "swings.csv", delimiter=",", skiprows=1)
data = ahnn.Trajectories(torch.tensor(table[:, 2]).view(30, -1, 1), torch.tensor(table[:41, 1]))
space = ahnn.Space("swings", ("angle", "p"), ahnn.Units("s", "rad", "rad/s", "J"))
options = ["sensor=recorded", f"data.noise={SD}", "hamiltonian=mechanical", "budget=smoke", "plugins=none"]
options += ["loss.stages=[[4,0.5],[16,1.0]]", "evaluation.figures=false"]
run = ahnn.fit(data, space, options, folder=folder / "run")

ahead = np.arange(0, 12.05, 0.1)  # three times as long as any measured swing
start = [1.5, 0.0]
forecast = run.predict(start, ahead)
angle, sd = forecast.states[0, :, 0].numpy(), forecast.deviations[0, :, 0].numpy()
truth = swing(1.5, ahead)
inside = np.mean(np.abs(angle - truth)[1:] < 2 * sd[1:])
worst = np.abs(angle - truth).max()
print(f"worst error {worst:.3f} rad, noise {SD} rad; {inside:.0%} within 2 standard deviations")

figure, (top, low) = plt.subplots(
    2, 1, figsize=(6, 4.5), layout="constrained", sharex=True, height_ratios=[2, 1]
)
near = np.argmin(np.abs(angles[:, 0] - 1.5))
top.plot(times, table[:, 2].reshape(30, -1)[near], ".", color="0.5", ms=4, label="one of 30 measured swings")
top.plot(ahead, angle, color="#D55E00", label="forecast from 1.5 rad at rest")
top.plot(ahead, truth, "k--", lw=1, label="truth (SciPy)")
top.set(ylabel="angle [rad]", ylim=(-1.8, 3.2), title="Forecast by a model learned from a noisy CSV")
top.legend(loc="upper right", ncols=2, fontsize="small")
low.fill_between(ahead, -2e3 * sd, 2e3 * sd, color="#56B4E9", alpha=0.5, label="2 standard deviations")
low.plot(ahead, 1e3 * (angle - truth), color="#D55E00", label="error")
low.set(xlabel="time [s]", ylabel="error [mrad]", xlim=(0, 12))
low.legend(loc="upper left", ncols=2, fontsize="small")
figure.savefig("noisy_csv.png", dpi=100)
