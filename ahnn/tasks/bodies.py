"""Two and three bodies in the plane, G = m = 1, from exact states (Greydanus, Dzamba & Yosinski 2019)."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import NBody
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import (
    Draw,
    FieldTask,
    Predict,
    energy_error,
    flow_through_encounters,
    numbers,
    states,
)
from ahnn.types import Trajectories

SOURCE = "greydanus/hamiltonian-nn, Apache 2.0; Greydanus, Dzamba & Yosinski 2019, arXiv:1906.01563"


def two(count: int, generator: np.random.Generator) -> Tensor:
    """Return nearly circular orbits of two bodies, (count, 8); with velocity errors of 5 % per component."""
    angle = generator.uniform(0, 2 * math.pi, count)
    radius = generator.uniform(0.5, 1.5, count)
    q = radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    turned = np.stack((-np.sin(angle), np.cos(angle)), axis=1)
    v = turned / (2 * np.sqrt(radius))[:, None] * (1 + 0.05 * generator.standard_normal((count, 2)))
    return states(np.concatenate((q, -q, v, -v), axis=1))


def three(count: int, generator: np.random.Generator) -> Tensor:
    """Return bodies on a rotating triangle, (count, 12); velocity components have errors up to 20 %."""
    seeded = torch.Generator().manual_seed(int(generator.integers(2**31)))
    return NBody(name="three_body", dt=0.1, steps=1).initial_states(count, seeded)


def draw(
    k: int, *, bodies: int, orbits: int, samples: int, duration: float, tested: tuple[int, float]
) -> Draw:
    """Draw exact orbits; `tested` gives the number of starts and the duration of the score."""
    begin = two if bodies == 2 else three
    system = NBody(name=f"{bodies}_bodies", bodies=bodies, dt=duration / (samples - 1), steps=samples - 1)
    with torch.no_grad():
        flow = exact_flow(system) if bodies == 2 else flow_through_encounters(system)
        exact = rollout(flow, begin(orbits, numbers(k)), system.dt, samples)
    count, long = tested
    starts = begin(count, numbers(k, 1))

    def score(predict: Predict) -> float:
        return energy_error(predict, starts, 500, long / 500, system.energy)

    times = torch.arange(samples, dtype=torch.float64) * system.dt
    return Draw(Trajectories(exact, times), system.space, (0.8, 0.15, 0.05), score)


PAIRS = ("model=hnn", "hamiltonian=pairs", "integrator=dopri8")
NETWORK = ("model=hnn", "loss=recursive", "integrator=dopri8", "trainer.max_epochs=10")
TWO = FieldTask(
    "two bodies from 800 orbits of 50 states",
    SOURCE,
    "squared energy error over 25 units of time, 15 initial states",
    "the published models also use exact derivatives; these use only states, 0.41 apart",
    {"baseline": 6.3e-2, "HNN": 3.9e-5},
    {"pairs": PAIRS},
    partial(draw, bodies=2, orbits=1000, samples=50, duration=20.0, tested=(15, 25.0)),
)
THREE = FieldTask(
    "three bodies from 4,000 orbits of 20 states",
    SOURCE,
    "squared energy error over 3 units of time, 15 initial states",
    "the published models also use exact derivatives; these use only states, 0.26 apart",
    {"baseline": 109.0, "HNN": 4.2e-2},
    {"network": NETWORK, "pairs": PAIRS},
    partial(draw, bodies=3, orbits=5000, samples=20, duration=5.0, tested=(15, 3.0)),
)
