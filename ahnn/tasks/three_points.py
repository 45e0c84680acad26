"""Three systems from 300 trajectories of four noisy states each (Celledoni, Eidnes & Myhr 2025)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import ChainPendulum, FilterNoise, HenonHeiles, System, Units
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, numbers, states
from ahnn.types import Trajectories

TRAJECTORIES, STEPS, STEP, NOISE = 300, 3, 0.8, 0.05
NEAR, FAR = 0.3, 0.6
"""Starts have squared distances from NEAR^2 to NEAR^2 + FAR^2 of the origin."""
TESTED = 100


@final
@dataclass(frozen=True, kw_only=True)
class StiffChain(System):
    """The Fermi-Pasta-Ulam-Tsingou chain of soft and stiff springs in turn, one stiff spring of it.

    H = p^2 / 2 + w^2 q_2^2 / 2 + ((q_1 - q_2)^4 + (q_1 + q_2)^4) / 4 (Hairer, Lubich & Wanner, Geometric
    Numerical Integration, section I.5.1, m = 1): q_1 is the middle of the stiff spring, q_2 its stretch.

    Attributes:
        stiffness: w.
    """

    stiffness: float = 2.0

    dof = 2
    components = ("q1", "q2", "p1", "p2")
    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...)."""
        a, b = x[..., 0], x[..., 1]
        kinetic = x[..., 2:].square().sum(-1) / (2 * self.mass)
        return kinetic + (self.stiffness * b).square() / 2 + ((a - b) ** 4 + (a + b) ** 4) / 4

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq, shape (..., 2)."""
        a, b = q.unbind(-1)
        less, more = (a - b) ** 3, (a + b) ** 3
        return torch.stack((-less - more, -(self.stiffness**2) * b + less - more), dim=-1)

    def initial_states(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw states of the task, shape (count, 4)."""
        seed = int(torch.randint(2**31, (), generator=generator))
        return begin(count, 4, np.random.default_rng(seed))


def begin(count: int, size: int, generator: np.random.Generator) -> Tensor:
    """Return starts (count, size) in random directions at random distances from the origin."""
    direction = generator.uniform(-1, 1, (count, size))
    radius = np.sqrt(NEAR**2 + FAR**2 * generator.random(count))
    return states(direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius[:, None])


def draw(k: int, *, system: System) -> Draw:
    """Return noisy trajectories of four samples, and the error of the flow from other starts."""
    generator, size = numbers(k), 2 * system.dof
    flow = exact_flow(system)
    with torch.no_grad():
        exact = rollout(flow, begin(TRAJECTORIES, size, generator), STEP, STEPS + 1)
        starts = begin(TESTED, size, numbers(k, 1))
        truth = rollout(flow, starts, STEP, STEPS + 1)
    noisy = exact + NOISE * states(generator.standard_normal(exact.shape))

    def flow_error(predict: Predict) -> float:
        return float((predict(starts, STEPS, STEP) - truth).mean(1).norm(dim=-1).mean())

    def rms(predict: Predict) -> float:
        return float((predict(starts, STEPS, STEP) - truth)[:, 1:].square().mean().sqrt())

    times = torch.arange(STEPS + 1, dtype=torch.float64) * STEP
    data = Trajectories(noisy, times)
    return Draw(data, system.space, (0.9, 0.05, 0.05), flow_error, also={"rms error": rms})


MEASURED = (
    "model=hnn",
    "sensor=recorded",
    "recipe=measurements",
    "data.measured=state",
    f"data.noise={NOISE}",
)
WAVES = "network=gaussian_process"
CHAIN = StiffChain(name="fermi_pasta", dt=STEP, steps=STEPS)
HENON = HenonHeiles(name="henon_heiles", dt=STEP, steps=STEPS)
DOUBLE = ChainPendulum(name="double_pendulum", gravity=1.0, dt=STEP, steps=STEPS)


def task(title: str, system: System) -> FieldTask:
    """Return the task of a system."""
    learned = {"network": MEASURED, "gaussian_process": (*MEASURED, WAVES)}
    if system.separable:
        learned["separable_gp"] = (*MEASURED, WAVES, "hamiltonian=separable")
    return FieldTask(
        f"{title} from {TRAJECTORIES} trajectories of {STEPS + 1} noisy states, {STEP:g} apart",
        "hakonnoren/learning_hamiltonian_noise, MIT; Celledoni, Eidnes & Myhr 2025, Physica D 472, 134471",
        f"norm of the mean of the error over {STEPS * STEP:g} units of time from {TESTED} exact starts; the "
        f"noise has {NOISE:g} a component",
        "270 trajectories train in the place of 285; the size of the noise is known",
        {},
        learned,
        partial(draw, system=system),
    )


def tasks() -> dict[str, FieldTask]:
    """Return the three by name."""
    named: dict[str, tuple[str, System]] = {
        "points_henon_heiles": ("Hénon-Heiles", HENON),
        "points_fermi_pasta": ("a Fermi-Pasta-Ulam-Tsingou chain", CHAIN),
        "points_double_pendulum": ("double pendulum", DOUBLE),
    }
    return {name: task(*about) for name, about in named.items()}
