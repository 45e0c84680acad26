"""Definition of a benchmark task: random data, models, score, and published results."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ahnn.systems import System
from ahnn.systems.truth import exact_flow
from ahnn.types import Flow, Space, Trajectories

Predict = Callable[[Tensor, int, float], Tensor]
"""(starts (B, 2n), steps, dt) -> states (B, steps + 1, 2n)."""


class Draw(NamedTuple):
    """Data and score of one draw.

    Attributes:
        data: trajectories of training, validation and test, in this order.
        space: space of their states.
        split: fractions of training, validation and test.
        score: score of predictions; lower is better.
        options: overrides of `ahnn.fit` required by this draw, such as its noise level.
        floor: lowest score allowed by the data; None if unknown.
        also: other scores of the same predictions, by name.
    """

    data: Trajectories
    space: Space
    split: tuple[float, float, float]
    score: Callable[[Predict], float]
    options: tuple[str, ...] = ()
    floor: Callable[[], float] | None = None
    also: Mapping[str, Callable[[Predict], float]] = MappingProxyType({})


class FieldTask(NamedTuple):
    """Benchmark task.

    Attributes:
        title: one-line description.
        source: paper or repository that defines it, with licence.
        quantity: description of the score.
        differs: differences from the published setting.
        published: published scores by name; empty if the paper gives its results only as plots.
        models: overrides of `ahnn.fit` by row name.
        draw: k -> the k-th draw of data and starts.
        floor: published floor, or score of the true form with free constants; None if draws have their own
            floors, or if unknown.
    """

    title: str
    source: str
    quantity: str
    differs: str
    published: Mapping[str, float]
    models: Mapping[str, tuple[str, ...]]
    draw: Callable[[int], Draw]
    floor: float | None = None


def energy_error(
    predict: Predict, starts: Tensor, steps: int, dt: float, energy: Callable[[Tensor], Tensor]
) -> float:
    """Return the mean squared difference between the true energies of predicted states and of their starts.

    True motion conserves energy, so the starts represent all times (Greydanus et al. 2019).

    Args:
        predict: model.
        starts: (B, 2n) initial states.
        steps: number of prediction steps.
        dt: step length.
        energy: H of states (..., 2n), shape (...).
    """
    found = energy(predict(starts, steps, dt))
    return float((found - found[:, :1]).square().mean())


def flow_through_encounters(system: System, parts: int = 64) -> Flow:
    """Return the exact flow of bodies with close encounters, with at least `parts` substeps per interval.

    A few runs determine the number of substeps; the closest encounters among thousands of runs need more.
    """
    cut = {"dt": system.dt / parts, "steps": system.steps * parts}
    return exact_flow(dataclasses.replace(system, **cut))


def numbers(draw: int, use: int = 0) -> np.random.Generator:
    """Return the random generator of a draw, independent for each use."""
    return np.random.default_rng((draw, use))


def states(values: np.ndarray) -> Tensor:
    """Return states as float64."""
    return torch.as_tensor(values, dtype=torch.float64)
