"""Segments of measurements in a fit: degrees of freedom, convergence, and limit of their cost."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.measurements import Segment
from ahnn.shooting.initial_states import HOPELESS

TIMES_TYPICAL = 5.0
"""Multiple of the median chi-square beyond which the cost of a segment grows logarithmically."""


def freedom(batch: Segment) -> Tensor:
    """Return the degrees of freedom of segments, (B,): measured values minus 2n initial-state components."""
    return (batch.measured - 2 * batch.instrument.dof).double()


def near(sums: Tensor, degrees: Tensor, hopeless: float = HOPELESS) -> Tensor:
    """Return the mask of converged segments, (B,) bool; derivatives beyond `hopeless` are meaningless."""
    return (sums <= hopeless * degrees) & (degrees > 0)


class Limit(NamedTuple):
    """Limit of the cost of each segment: for inaccurate dynamics a few segments would dominate the sum.

    Attributes:
        most: (B,) sum of squares beyond which a segment counts only logarithmically.
    """

    most: Tensor

    @classmethod
    def of(cls, sums: Tensor, degrees: Tensor) -> Limit:
        """Return the limits of segments with these sums of squares and degrees of freedom, (B,)."""
        typical = (sums / degrees).median().clamp(min=1.0) if len(sums) else 1.0
        return cls(TIMES_TYPICAL * typical * degrees)

    def rows(self, part: slice) -> Limit:
        """Return the limits of some of the segments."""
        return Limit(self.most[part])

    def cost(self, sums: Tensor) -> Tensor:
        """Return the limited cost of sums of squares (B,)."""
        return torch.where(sums <= self.most, sums, self.most * (1 + (sums / self.most).log()))

    def weight(self, sums: Tensor) -> Tensor:
        """Return the derivative of the cost, (B,)."""
        return (self.most / sums).clamp(max=1.0)
