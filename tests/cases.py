"""Cases made by hand: a spring and an orbit with a flow that is slightly wrong, nothing trained."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ahnn.dynamics.base import Dynamics
from ahnn.evaluation import Case, Results, Row, Who
from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.metrics import Scores
from ahnn.rollouts import rollout
from ahnn.systems import Kepler, MassSpring, Molniya, System
from ahnn.types import Space, Trajectories, Units

RK4 = INTEGRATORS["rk4"]
SPRING = MassSpring(name="spring", dt=0.01, steps=120, mass=2.0)
STIFFER = dataclasses.replace(SPRING, stiffness=5.05)
KEPLER = Kepler(name="kepler", dt=0.05, steps=80)
ORBITS = Molniya(name="orbits", dt=60.0, steps=60)
SPACE = Space("spring", ("q", "p"), Units("s", "m", "m/s", "J"), 2.0)
MODEL = Who("model", "true")


class Stiffness(nn.Module):
    """A spring whose stiffness is learned."""

    def __init__(self, stiffness):
        super().__init__()
        self.stiffness = nn.Parameter(torch.tensor([stiffness], dtype=torch.float64))

    def forward(self, x):
        q, p = x.chunk(2, dim=-1)
        return torch.cat((p / SPRING.mass, -self.stiffness * q), dim=-1)


class Learned(Dynamics):
    """The same by RK4."""

    def __init__(self, stiffness=SPRING.stiffness + 0.01):
        super().__init__()
        self.field = Stiffness(stiffness)

    def fit(self, statistics):
        pass

    def increment(self, x, dt):
        return RK4.increment(self.field, x, dt)


def trajectories(system: System, count: int, seed: int) -> Trajectories:
    """Exact trajectories of the system's own steps, on one grid of times."""
    x = system.initial_states(count, torch.Generator().manual_seed(seed))
    flow = Integrated(system, INTEGRATORS[system.integrator])
    states = rollout(flow, x, system.dt, system.steps + 1)
    times = system.dt * torch.arange(system.steps + 1, dtype=torch.float64)
    return Trajectories(states, times.expand(count, -1))


def make_case(folder: Path, system: System = SPRING, wrong: System | None = STIFFER, **changes: Any) -> Case:
    """A case on three trajectories; `wrong` is the system that was learned, and None takes the right one."""
    learned = wrong or system
    case = Case(
        label="model of mine",
        assumes="all but the stiffness",
        space=system.space,
        truth=system,
        flow=Integrated(learned, RK4),
        energy=learned.energy,
        integrator=RK4,
        dt=system.dt,
        test=trajectories(system, 3, 1),
        validation=trajectories(system, 2, 2),
        train=trajectories(system, 2, 3),
        perturbation=perturbations(system, 3, 0),
        folder=folder,
    )
    return dataclasses.replace(case, **changes)


def scores(
    value: float = 1.0, energy: float | None = 2.0, components: tuple[float, ...] = (1.0, 2.0)
) -> Scores:
    return Scores(value, value, value, value, energy, components)


def make_results(*rows: Row, **changes: Any) -> Results:
    return Results("model of mine", "nothing", SPACE, rows)._replace(**changes)


def drop(case: Case, cut: Tensor) -> Case:
    """The case with the test samples in `cut`, (B, T) bool, absent."""
    states = case.test.states.masked_fill(cut.unsqueeze(-1), torch.nan)
    return dataclasses.replace(case, test=case.test._replace(states=states))
