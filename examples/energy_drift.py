"""Which integrator keeps the energy of an orbit? `python examples/energy_drift.py`."""

import math

import matplotlib.pyplot as plt
import torch

from ahnn.integrators import make_integrator
from ahnn.rollouts import rollout
from ahnn.systems import Kepler

orbits, calls = 100, 240  # revolutions, evaluations of the force in each
kepler = Kepler(name="kepler", dt=0.1, steps=10)  # GM = 1
eccentricity = 0.5  # semi-major axis 1: the period is 2 pi, the energy -1/2
start = torch.tensor([[1 - eccentricity, 0, 0, ((1 + eccentricity) / (1 - eccentricity)) ** 0.5]]).double()
stages = {"rk4": 4, "leapfrog": 1, "yoshida4": 3, "kahan_li8": 17}  # evaluations in a step

figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
worst = {}
for name, count in stages.items():
    steps = calls // count  # in each revolution
    method, dt = make_integrator(name), 2 * math.pi / steps
    states = rollout(lambda x, dt, method=method: method.step(kepler, x, dt), start, dt, orbits * steps + 1)
    q, v = states[0].double().chunk(2, dim=-1)
    energy = v.square().sum(-1) / 2 - 1 / q.norm(dim=-1)
    worst[name] = (energy + 0.5).abs()[1:].view(orbits, steps).amax(1) / 0.5  # of each revolution
    axes.loglog(range(1, orbits + 1), worst[name], label=f"{name}, {steps} steps per orbit")
    print(
        f"{name:10s} worst energy error: orbit 1 {worst[name][0]:.1e}, orbit {orbits} {worst[name][-1]:.1e}"
    )
axes.set(xlabel="orbit", ylabel="worst relative error of the energy")
axes.set_title(f"Kepler orbit, e = {eccentricity}, {calls} force evaluations per orbit")
axes.grid(alpha=0.3)
axes.set_ylim(1e-6, 1)
axes.legend(ncols=2, loc="upper left", fontsize=8)
figure.savefig("energy_drift.png", dpi=100)
