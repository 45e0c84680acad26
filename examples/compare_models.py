"""Does a Hamiltonian help? Two models, three seeds: `python examples/compare_models.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.rollouts import rollout
from ahnn.systems import Pendulum, exact_flow

DT, STEPS = 0.1, 300
exact = exact_flow(Pendulum(name="pendulum", dt=DT, steps=10))  # 1 kg on 1 m
generator = torch.Generator().manual_seed(0)
begin = torch.tensor([2.0, 4.0]) * (2 * torch.rand(40, 2, generator=generator, dtype=torch.float64) - 1)
data = ahnn.Trajectories(rollout(exact, begin, DT, 11), DT * torch.arange(11, dtype=torch.float64))
now, later = data.states[:, :-1].flatten(0, 1), data.states[:, 1:].flatten(0, 1)
unseen = torch.stack((torch.linspace(0.2, 1.5, 10), torch.zeros(10)), dim=-1).double()
truth = rollout(exact, unseen, DT, STEPS + 1)


def errors(build, seed):
    """Return the rms angle error of unseen swings over time, (STEPS + 1,)."""
    torch.manual_seed(seed)
    model = build(dof=1, hidden=24, data=data).double()
    optimizer = torch.optim.LBFGS(
        model.parameters(), max_iter=100, tolerance_change=0, line_search_fn="strong_wolfe"
    )

    def loss():
        optimizer.zero_grad()
        value = ((model(now, DT) - later) / DT).square().mean()
        value.backward()
        return value

    optimizer.step(loss)
    with torch.no_grad():
        path = rollout(model, unseen, DT, STEPS + 1)
    return (path - truth)[..., 0].square().mean(0).sqrt()


times = DT * torch.arange(STEPS + 1)
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
scores = {}
for name, build, colour in (
    ("neural ODE", ahnn.NeuralODE, "#0072B2"),
    ("Hamiltonian", ahnn.Hamiltonian, "#D55E00"),
):
    each = torch.stack([errors(build, seed) for seed in (1, 2, 3)])  # (3, STEPS + 1)
    scores[name] = each.log().mean(0).exp()  # geometric mean
    axes.fill_between(times, each.amin(0), each.amax(0), color=colour, alpha=0.25)
    axes.semilogy(times, scores[name], color=colour, label=f"{name}: mean and range of three seeds")
    print(f"{name}: rms error after {times[-1]:g} s: " + ", ".join(f"{e:.2g}" for e in each[:, -1].tolist()))
axes.set(xlabel="time [s]", ylabel="rms error of the angle [rad]", xlim=(0, times[-1]), ylim=(1e-6, 3))
axes.set_title("Unseen swings of a pendulum, same data and steps")
axes.grid(alpha=0.3)
axes.legend(loc="lower right")
figure.savefig("compare_models.png", dpi=100)
