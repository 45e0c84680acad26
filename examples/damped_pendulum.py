"""How much friction has a pendulum whose swings were filmed? `python examples/damped_pendulum.py`."""

import tempfile

import matplotlib.pyplot as plt
import torch
from scipy.integrate import solve_ivp

import ahnn

FRICTION, SD = 0.3, 0.01  # kg m^2/s on 1 kg m^2; rad
times = torch.arange(0.0, 3.05, 0.1, dtype=torch.float64)
generator = torch.Generator().manual_seed(1)


def swing(angle):
    """Return angle and momentum of a damped pendulum of 1 m that is let go, (T, 2)."""
    pull = lambda _, x: [x[1], -9.81 * torch.tensor(x[0]).sin() - FRICTION * x[1]]  # noqa: E731
    found = solve_ivp(pull, (0, 3.05), [angle, 0.0], "DOP853", times.numpy(), rtol=1e-10, atol=1e-10)
    return torch.from_numpy(found.y.T)


truth = torch.stack([swing(a) for a in (0.4 + 1.6 * torch.rand(20, generator=generator)).tolist()])
angles = truth[..., :1] + SD * torch.randn(20, len(times), 1, generator=generator)
data = ahnn.Trajectories(angles, times)
space = ahnn.Space("pendulum", ("angle", "p"), ahnn.Units("s", "rad", "rad/s", "J"))
options = ["sensor=recorded", f"data.noise={SD}", "hamiltonian=mechanical", "forces=friction", "budget=smoke"]
options += ["loss.stages=[[4,0.5],[16,1.0]]", "evaluation.figures=false"]
run = ahnn.fit(data, space, [*options, "plugins=none"], folder=tempfile.mkdtemp() + "/run")
((name, (value, sd)),) = run.constants.items()
print(f"{name}: {value:.4f} ± {sd:.4f} kg m²/s, truth {FRICTION}")

path = run.rollout(truth[:1, 0], len(times) - 1)[0]  # [angle, momentum]
lost = run.energy(truth[0]) - run.energy(truth[0, :1])  # by the learned Hamiltonian, along the true swing
kept = truth[0, :, 1] ** 2 / 2 + 9.81 * (1 - truth[0, :, 0].cos())
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
left.plot(times, angles[0, :, 0], ".", color="0.5", label="measured")
left.plot(times, truth[0, :, 0], "k--", lw=1, label="truth (SciPy)")
left.plot(times, path[:, 0], color="#D55E00", label="learned", zorder=0, lw=3, alpha=0.6)
left.set(xlabel="time [s]", ylabel="angle [rad]", title="One of 20 swings")
left.legend(fontsize="small")
right.plot(times, kept - kept[0], "k--", lw=1, label="truth")
right.plot(times, lost, color="#D55E00", label="learned", zorder=0, lw=3, alpha=0.6)
right.set(xlabel="time [s]", ylabel="energy − energy at the start [J]")
right.set_title(f"friction {value:.4f} ± {sd:.4f} kg m²/s, truth {FRICTION}", fontsize="medium")
right.legend(fontsize="small")
figure.savefig("damped_pendulum.png", dpi=100)
