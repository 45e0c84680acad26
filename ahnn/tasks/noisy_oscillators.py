"""A spring and a pendulum from 25 short, very noisy trajectories (Greydanus, Dzamba & Yosinski 2019)."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch

from ahnn.rollouts import rollout
from ahnn.systems import MassSpring, Pendulum
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, energy_error, numbers, states
from ahnn.types import Space, Trajectories

TRAJECTORIES, NOISE, DURATION = 50, 0.1, 3.0
SPLIT = (0.5, 0.4, 0.1)
STARTS, LONG, STEP = 1000, 20.0, 0.05
TWO_SQUARES = MassSpring(name="spring", mass=0.5, stiffness=2.0, dt=0.1, steps=30)
PLANE_PENDULUM = Pendulum(name="pendulum", mass=0.5, gravity=4.0, dt=0.07, steps=45)
MEASURED = ("sensor=recorded", "recipe=noisy_states", "data.measured=state", f"data.noise={NOISE}")
SOURCE = "greydanus/hamiltonian-nn, Apache 2.0; Greydanus, Dzamba & Yosinski 2019, arXiv:1906.01563"


def draw(k: int, *, system: MassSpring | Pendulum, rate: int, radii: tuple[float, float]) -> Draw:
    """Draw trajectories from random directions at a random radius, with noise on every value."""
    generator = numbers(k)
    direction = generator.uniform(-1, 1, (TRAJECTORIES, 2))
    radius = generator.uniform(*radii, (TRAJECTORIES, 1))
    begin = states(direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius)
    times = torch.linspace(0, DURATION, int(rate * DURATION), dtype=torch.float64)
    with torch.no_grad():
        exact = rollout(exact_flow(system), begin, float(times[1]), len(times))
    noisy = exact + NOISE * states(generator.standard_normal(exact.shape))
    starts = states(numbers(k, 1).uniform(-1, 1, (STARTS, 2)))

    def score(predict: Predict) -> float:
        return energy_error(predict, starts, round(LONG / STEP), STEP, system.energy)

    return Draw(Trajectories(noisy, times), Space("oscillator", ("q", "p"), inertia=0.5), SPLIT, score)


WAVES = "network=gaussian_process"
MODELS = {
    "network": ("model=hnn", *MEASURED),
    "gaussian_process": ("model=hnn", WAVES, *MEASURED),
    "mechanical_gp": ("model=hnn", WAVES, "hamiltonian=mechanical", *MEASURED),
}
SPRING = FieldTask(
    "spring, q^2 + p^2, from 25 trajectories of 30 noisy states",
    SOURCE,
    f"squared energy error over {LONG:g} units of time, {STARTS} initial states in [-1, 1]^2",
    "the published models also use exact derivatives; these use only noisy states",
    {"baseline": 0.17, "HNN": 3.8e-4},
    MODELS,
    partial(draw, system=TWO_SQUARES, rate=10, radii=(0.1, 1.0)),
    2.3e-5,
)
PENDULUM = FieldTask(
    "pendulum, 2 (1 - cos q) + p^2, from 25 trajectories of 45 noisy states",
    SOURCE,
    f"squared energy error over {LONG:g} units of time, {STARTS} initial states in [-1, 1]^2",
    "as in noisy_spring; the published energy of this task is q^2 + p^2, here it is the pendulum's",
    {"baseline": 4.15e-2, "HNN": 2.49e-2},
    MODELS,
    partial(draw, system=PLANE_PENDULUM, rate=15, radii=(0.2, 2.0)),
)
