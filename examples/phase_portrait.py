"""Does the learned energy have the separatrix of a pendulum? `python examples/phase_portrait.py`."""

import matplotlib.pyplot as plt
import torch

import ahnn
from ahnn.rollouts import rollout
from ahnn.systems import Pendulum, exact_flow

torch.manual_seed(0)
pendulum = Pendulum(name="pendulum", dt=0.05, steps=20)  # 1 kg on 1 m
start = torch.tensor([3.14, 9.0]) * (2 * torch.rand(100, 2, dtype=torch.float64) - 1)
states = rollout(exact_flow(pendulum), start, 0.05, 21)  # (100, 21, 2): 1 s each
data = ahnn.Trajectories(states, 0.05 * torch.arange(21, dtype=torch.float64))

model = ahnn.Hamiltonian(dof=1, hidden=24, inputs="angles", angular=[True], data=data).double()
now, later = states[:, :-1].flatten(0, 1), states[:, 1:].flatten(0, 1)
optimizer = torch.optim.LBFGS(model.parameters(), max_iter=300, line_search_fn="strong_wolfe")


def loss():
    optimizer.zero_grad()
    value = (model(now, 0.05) - later).square().mean()
    value.backward()
    return value


optimizer.step(loss)
q, p = torch.linspace(-3.14, 3.14, 121).double(), torch.linspace(-8.5, 8.5, 121).double()
grid = torch.cartesian_prod(q, p)
true = (grid[:, 1] ** 2 / 2 + 9.81 * (1 - grid[:, 0].cos())).view(121, 121)  # J
with torch.no_grad():
    learned = model.energy(grid).view(121, 121)
learned += (true - learned).mean()  # an energy is known up to a constant
error = float((learned - true).square().mean().sqrt())
print(f"learned energy: rms error {error:.4f} J, separatrix at {2 * 9.81:.2f} J")

figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
levels = [1, 5, 10, 15, 19.62, 25, 32]
filled = axes.contourf(q, p, learned.T, 60, cmap="viridis")
axes.contour(q, p, learned.T, levels, colors="white", linewidths=2)
axes.contour(q, p, true.T, levels, colors="black", linewidths=1, linestyles="dashed")
axes.plot([], [], "k--", lw=1, label="true, same levels")
axes.plot([], [], color="white", lw=2, label="learned")
axes.legend(loc="upper right", facecolor="0.5", labelcolor="white")
axes.set_xticks([-3.14, -1.57, 0, 1.57, 3.14], ["−π", "−π/2", "0", "π/2", "π"])
axes.set(xlabel="angle [rad]", ylabel="momentum [kg m²/s]", title="Energy of a pendulum, learned from states")
figure.colorbar(filled, label="learned energy [J]")
figure.savefig("phase_portrait.png", dpi=100)
