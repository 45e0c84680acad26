"""Pendulum, double pendulum and three bodies from exact, widely spaced states (Horn et al. 2025).

Maps from one sample to the next, and vector fields, are trained with the same budget: a number of epochs of
second-order steps on all windows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import ChainPendulum, NBody, Pendulum, System
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, flow_through_encounters, numbers, states
from ahnn.types import Trajectories

SOURCE = "AELITTEN/GHNN, MIT; Horn et al. 2025, J. Comput. Phys. 521, 113536"
NETWORK, WAVES = ("network=tanh_16",), "network=gaussian_process"
SPLIT = (0.8, 0.1, 0.1)


class Sampling(NamedTuple):
    """Training and test trajectories of a map.

    Attributes:
        system: system whose interval is the step of the map, and whose number of steps is that of the runs.
        runs: number of trajectories, of which a tenth is for validation and a tenth for test.
        tested: number of test steps.
        begin: (count, draw) -> starts.
        quarter: whether trajectories end at the zero crossing of the first coordinate, a quarter of a swing.
    """

    system: System
    runs: int
    tested: int
    begin: Callable[[int, int], Tensor]
    quarter: bool = False


def hanging(count: int, draw: int, *, links: int, most: float) -> Tensor:
    """Return pendulums at rest at uniform angles up to a number of half turns, (count, 2 links)."""
    q = states(numbers(draw).uniform(-most * math.pi, most * math.pi, (count, links)))
    return torch.cat((q, torch.zeros_like(q)), dim=-1)


def bodies(count: int, draw: int) -> Tensor:
    """Return three bodies on a rotating triangle, (count, 12)."""
    return THREE.initial_states(count, torch.Generator().manual_seed(draw))


def first_quarter(exact: Tensor) -> Tensor:
    """Return trajectories (B, T, 2) up to the first sample past q = 0, NaN after it."""
    passed = (exact[..., :1] * exact[:, :1, :1] < 0).cummax(1).values
    before = torch.cat((torch.zeros_like(passed[:, :1]), passed[:, :-1]), dim=1)
    return exact.masked_fill(before, torch.nan)


def draw(k: int, *, sampling: Sampling) -> Draw:
    """Draw exact trajectories; the score is the mean absolute error in tests, angles modulo a full turn."""
    system, runs = sampling.system, sampling.runs
    starts = sampling.begin(runs, k)
    tests = starts[round(runs * (1 - SPLIT[2])) :]
    flow = flow_through_encounters(system) if system is THREE else exact_flow(system)
    with torch.no_grad():
        exact = rollout(flow, starts, system.dt, system.steps + 1)
        truth = rollout(flow, tests, system.dt, sampling.tested + 1)
    seen = first_quarter(exact) if sampling.quarter else exact

    def score(predict: Predict) -> float:
        off = (predict(tests, sampling.tested, system.dt) - truth).abs()
        for k in [k for k, angle in enumerate(system.space.angular) if angle]:
            off[..., k] = math.pi - (off[..., k] % (2 * math.pi) - math.pi).abs()
        return float(off.mean())

    times = torch.arange(system.steps + 1, dtype=torch.float64) * system.dt
    return Draw(Trajectories(seen, times), system.space, SPLIT, score)


def models(epochs: int, *fields: str, **more: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the benchmark models for a common budget.

    Args:
        epochs: number of training epochs, on all windows.
        fields: overrides for the models that learn a vector field.
        more: overrides of additional models, by name.
    """
    budget = (f"trainer.max_epochs={epochs}", "data.windows_per_epoch=null", "plugins=none")
    named = {
        "mlp": ("model=mlp",),
        "node": ("model=node", "loss=recursive", *fields),
        "sympnet_G": ("model=sympnet",),
        "sympnet_LA": ("model=sympnet", "model.form=LA"),
        "henon_net": ("model=henon_net",),
        "ghnn": ("model=ghnn",),
        "srnn": ("model=srnn",),
        "hnn": ("model=hnn", "loss=recursive", *fields),
        "gp_hamiltonian": ("model=hnn", WAVES, "loss=recursive", *fields),
        **more,
    }
    return {name: (*row, *(() if WAVES in row else NETWORK), *budget) for name, row in named.items()}


LNN = ("model=lnn", "loss=recursive", "integrator=dopri5")
MECHANICAL = ("model=hnn", "hamiltonian=mechanical", "inputs=angles", "loss=recursive", "integrator=dopri5")
MASS_MATRIX = ("model=hnn", "hamiltonian=mass_matrix", "inputs=angles", "loss=recursive", "integrator=dopri5")
PAIRS = ("model=hnn", "hamiltonian=pairs", "integrator=dopri8", "loss=recursive")
PENDULUM = Pendulum(name="pendulum", gravity=1.0, dt=0.1, steps=48)
DOUBLE = ChainPendulum(name="double_pendulum", gravity=1.0, dt=0.1, steps=50)
THREE = NBody(name="three_body", dt=0.5, steps=10)
ERROR = "absolute error of a component, mean over {:g} units of time and {} unseen runs"
SAME = "the same number of second-order steps for all models; runs are drawn anew"

TASKS: dict[str, FieldTask] = {
    "map_pendulum": FieldTask(
        "pendulum from the first quarter swing of 400 runs, 0.1 apart",
        SOURCE,
        ERROR.format(10, 50),
        f"{SAME}; the error covers the same time in all runs, not one period of each",
        {},
        models(30, "integrator=dopri5", lnn=LNN, mechanical=MECHANICAL),
        partial(
            draw,
            sampling=Sampling(PENDULUM, 500, 100, partial(hanging, links=1, most=0.95), quarter=True),
        ),
    ),
    "map_double_pendulum": FieldTask(
        "double pendulum from 1,600 runs of 51 states, 0.1 apart",
        SOURCE,
        ERROR.format(10, 200),
        SAME,
        {},
        models(5, "integrator=dopri5", mass_matrix=MASS_MATRIX),
        partial(draw, sampling=Sampling(DOUBLE, 2000, 100, partial(hanging, links=2, most=0.5))),
    ),
    "map_three_bodies": FieldTask(
        "three bodies from 4,000 runs of 11 states, 0.5 apart",
        SOURCE,
        ERROR.format(7, 500),
        SAME,
        {},
        models(5, "integrator=dopri8", pairs=PAIRS),
        partial(draw, sampling=Sampling(THREE, 5000, 14, bodies)),
    ),
}
