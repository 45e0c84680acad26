"""Has a learned flow the islands and the chaos of the true one? `python examples/henon_heiles_section.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.rollouts import rollout
from ahnn.systems import HenonHeiles, exact_flow

torch.manual_seed(0)
ENERGY, DT, STEPS = 0.125, 0.1, 6000
system = HenonHeiles(name="henon_heiles", dt=DT, steps=10)
exact = exact_flow(system)
start = 0.9 * (2 * torch.rand(600, 4, dtype=torch.float64) - 1)
start = start[system.energy(start) < 1 / 6]
states = rollout(exact, start, DT, 11)
states = states[states.abs().amax((1, 2)) < 1.1]  # bounded ones
data = ahnn.Trajectories(states, DT * torch.arange(11, dtype=torch.float64))
model = ahnn.Hamiltonian(dof=2, hidden=32, structure="mechanical", integrator="leapfrog", data=data).double()
now, later = states[:, :-1].flatten(0, 1), states[:, 1:].flatten(0, 1)
optimizer = torch.optim.LBFGS(
    model.parameters(), max_iter=800, tolerance_change=0, line_search_fn="strong_wolfe"
)


def loss():
    optimizer.zero_grad()
    value = ((model(now, DT) - later) / DT).square().mean()
    value.backward()
    return value


optimizer.step(loss)


def section(flow):
    """Return (y, p_y) where 24 orbits of one energy cross x = 0 upwards."""
    y = torch.linspace(-0.42, 0.62, 24).double()
    px = (2 * ENERGY - y**2 + 2 * y**3 / 3).clamp(min=0).sqrt()
    begin = torch.stack((torch.zeros(24), y, px, torch.zeros(24)), dim=-1).double()
    path = rollout(flow, begin, DT, STEPS + 1)
    a, b = path[:, :-1], path[:, 1:]
    crossed = (a[..., 0] < 0) & (b[..., 0] >= 0)
    a, b = a[crossed], b[crossed]
    return (a + (b - a) * (-a[:, :1] / (b - a)[:, :1]))[:, [1, 3]], path


figure, panels = plt.subplots(1, 2, figsize=(8, 4.6), layout="constrained", sharex=True, sharey=True)
paths = {}
for axes, (name, flow) in zip(panels, {"true": exact, "learned": model}.items(), strict=True):
    points, paths[name] = section(flow)
    axes.plot(*points.T, ".", ms=1, color="k" if name == "true" else "#D55E00")
    axes.set(title=f"{name}", xlabel="y", aspect="equal")
panels[0].set_ylabel("$p_y$")
figure.suptitle(f"Hénon-Heiles at energy 1/8: section at x = 0, over {STEPS * DT:g} units of time")
drift = (system.energy(paths["learned"]) - ENERGY).abs().max()
print(f"true energy along learned orbits: {ENERGY} within {drift:.1e}")
figure.savefig("henon_heiles_section.png", dpi=100)
