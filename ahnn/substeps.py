"""Number of equal steps that cover a time gap, shared by rollouts, paths, filters and exact flows."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.types import TimeStep

SLACK = 1e-9
"""Tolerance relative to a step: a gap of 60.000000000000007 is one step of 60, not two of 30."""


def substeps(gap: TimeStep, longest: float) -> int:
    """Return the number of equal steps, at least one, none longer than `longest`.

    Args:
        gap: duration, or one for each member; the longest determines the number, and NaN is ignored.
        longest: maximum step length; infinity gives one step.
    """
    length = float(gap.detach().abs().nan_to_num().max()) if isinstance(gap, Tensor) else abs(gap)
    return 1 if math.isnan(length) else max(1, math.ceil(length / longest - SLACK))


def longest_part(gap: TimeStep, step: float) -> float:
    """Return the maximum length of a part of a gap: `step` if the gap is 1.5 times as long, else infinity."""
    return step if substeps(gap, 1.5 * step) > 1 else math.inf


def substeps_of_each(gaps: Tensor, longest: float) -> Tensor:
    """Return the number of steps of each gap, as integers of the shape of `gaps`."""
    return torch.ceil(gaps / longest - SLACK).clamp(min=1.0).long()
