"""Can a filter follow a satellite if every tenth fix is wrong? `python examples/stream_with_outliers.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position
from ahnn.rollouts import rollout
from ahnn.systems import Molniya, exact_flow
from ahnn_plugins.ukf import unscented_filter, unscented_smoother

run = ahnn.load("molniya_mechanical")
DT, STEPS, SD = 300.0, 144, 1.0  # s; half a day, one orbit; km
truth_flow = exact_flow(Molniya(name="molniya", dt=60.0, steps=10))
start = torch.tensor([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]], dtype=torch.float64)
truth = rollout(truth_flow, start, DT, STEPS + 1, longest=60.0)[:, 1:]

generator = torch.Generator().manual_seed(1)
fixes = truth[..., :3] + SD * torch.randn(1, STEPS, 3, generator=generator).double()
wrong = torch.rand(STEPS, generator=generator) < 0.1
fixes[0, wrong] += 50 * torch.randn(int(wrong.sum()), 3, generator=generator).double()


def learned(x, dt):
    for _ in range(5):  # steps of a minute, as in the training
        x = run.dynamics(x, dt / 5)
    return x


off = torch.tensor([10.0, -10.0, 10.0, 0.01, 0.01, -0.01], dtype=torch.float64)
belief = initial_belief(start + off, torch.diag(off**2))
noise, process = SD**2 * torch.eye(3), torch.diag(torch.tensor([1e-3] * 3 + [1e-5] * 3) ** 2)
result = unscented_filter(
    learned,
    belief,
    fixes,
    Position(),
    lambda _: process.double(),
    noise.double(),
    DT,
    gate=Gate(0.9999),
    smoothing=True,
)
smoothed = unscented_smoother(result)
errors = {"filter": result.means, "smoother": smoothed.means}
errors = {name: (means - truth)[0, :, :3].norm(dim=1) for name, means in errors.items()}
rejected = result.rejected[0].bool()
print(f"{int(wrong.sum())} wrong fixes, {int(rejected.sum())} rejected, both {int((rejected & wrong).sum())}")
print({name: f"{float(e.square().mean().sqrt()):.2f} km rms" for name, e in errors.items()})

hours = DT * torch.arange(1, STEPS + 1) / 3600
of_fixes = (fixes - truth[..., :3])[0].norm(dim=1)
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
axes.semilogy(hours, of_fixes, ".", color="0.6", label="fixes")
axes.plot(hours[rejected], of_fixes[rejected], "x", color="k", label="rejected by the gate")
axes.plot(hours, errors["filter"], color="#0072B2", label="filter")
axes.plot(hours, errors["smoother"], color="#D55E00", label="smoother")
axes.set(xlabel="time [h]", ylabel="position error [km]", xlim=(0, 12), ylim=(0.03, 5e3))
axes.set_title("One Molniya orbit, fixes of 1 km every five minutes")
axes.grid(alpha=0.3)
axes.legend(ncols=2, loc="upper right", framealpha=0.9)
figure.savefig("stream_with_outliers.png", dpi=100)
