"""Into how many equal steps a gap is cut: the one rule of rollouts, paths, filters and exact flows."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.types import TimeStep

SLACK = 1e-9
"""Of a step: a gap of 60.000000000000007 is one step of 60, not two of 30."""


def substeps(gap: TimeStep, longest: float) -> int:
    """Return the number of equal steps, one at least, of which none is longer than `longest`.

    Args:
        gap: length of time, or one for each member, of which the longest counts; NaN counts as none.
        longest: length of a step, infinite for one step.
    """
    length = float(gap.abs().nan_to_num().max()) if isinstance(gap, Tensor) else abs(gap)
    return 1 if math.isnan(length) else max(1, math.ceil(length / longest - SLACK))


def substeps_of_each(gaps: Tensor, longest: float) -> Tensor:
    """Return the number of steps of each gap, in whole numbers of the shape of `gaps`."""
    return torch.ceil(gaps / longest - SLACK).clamp(min=1.0).long()
