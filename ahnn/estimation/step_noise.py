"""Time grid of a filter, and process noise of each step."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.argument_checks import checked_steps
from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance, covariance_factor
from ahnn.estimation.results import ProcessNoise
from ahnn.numbers import Numbers


class StepGrid(NamedTuple):
    """Time steps: T lengths, and end times (T,)."""

    lengths: list[float]
    times: Tensor

    @classmethod
    def of(cls, dt: Numbers, steps: int, start: Tensor) -> StepGrid:
        """Build T steps of one length or of lengths (T,) from a start time.

        Raises:
            ValueError: wrong shape, or steps that are not positive.
        """
        lengths = checked_steps(dt, steps)
        if lengths.ndim == 0:
            ends = start + lengths * torch.arange(1, steps + 1, device=start.device)
            return cls([float(lengths)] * steps, ends)
        return cls(lengths.tolist(), start + lengths.cumsum(0).to(start.device))


def process_factor(process_noise: ProcessNoise, belief: Belief) -> Callable[[float], Tensor]:
    """Return the factor of Q, (B, D, D), as a function of step length; each length is factored only once.

    Raises:
        ValueError: Q is not a covariance; raised by the returned function if Q depends on the step length.
    """
    batch, size = belief.mean.shape

    def factor(matrix: Covariance) -> Tensor:
        chol = covariance_factor(matrix, "Q", batch=batch, size=size, definite=False)
        return chol.to(belief.mean.device).expand(batch, size, size)

    if callable(process_noise):
        return cache(lambda dt: factor(process_noise(dt)))
    constant = factor(process_noise)
    return lambda _: constant
