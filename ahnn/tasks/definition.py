"""A task of the field: data drawn from a number, models that learn them, a score, and what was published."""

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
    """What a model learns from, and how it is judged.

    Attributes:
        data: trajectories of training, validation and test, in this order.
        space: of their states.
        split: fractions of the three.
        score: of predictions; less is better.
        options: overrides of `ahnn.fit` that this drawing needs, such as the size of its noise.
        floor: the least score that its data allow; None where nobody knows one.
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
    """A task of the field.

    Attributes:
        title: what is learned, on one line.
        source: paper or repository that defines it, with licence.
        quantity: what the score is.
        differs: from the published setting.
        published: scores by their name there; none where the paper has figures only.
        models: overrides of `ahnn.fit` by the name of a row.
        draw: k -> the k-th drawing of data and starts.
        floor: the published one, or what the true form with free constants scores; None where drawings have
            floors of their own, or where nobody measured one.
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

    That of the true motion is conserved, so that it stands for the whole of it (Greydanus et al. 2019).

    Args:
        predict: the model.
        starts: (B, 2n).
        steps: of the prediction.
        dt: length of a step.
        energy: H of states (..., 2n), shape (...).
    """
    found = energy(predict(starts, steps, dt))
    return float((found - found[:, :1]).square().mean())


def flow_through_encounters(system: System, parts: int = 64) -> Flow:
    """Return the exact flow of bodies some of which meet closely, by substeps of a part of the interval.

    Substeps are chosen by a few runs; of thousands, the closest encounters need shorter ones.
    """
    cut = {"dt": system.dt / parts, "steps": system.steps * parts}
    return exact_flow(dataclasses.replace(system, **cut))


def numbers(draw: int, use: int = 0) -> np.random.Generator:
    """Return random numbers for a drawing; those of another use are independent of them."""
    return np.random.default_rng((draw, use))


def states(values: np.ndarray) -> Tensor:
    """Return states as float64."""
    return torch.as_tensor(values, dtype=torch.float64)
