"""What every estimator speaks of: a Gaussian belief, what became of a member, and when to refuse a row."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from torch import Tensor


class Belief(NamedTuple):
    """Gaussian beliefs about the states of B members.

    Attributes:
        mean: (B, D) float64.
        chol: (B, D, D) lower factor, covariance = chol cholᵀ.
    """

    mean: Tensor
    chol: Tensor

    @property
    def covariance(self) -> Tensor:
        """Covariance (B, D, D)."""
        return self.chol @ self.chol.mT


class Status(IntEnum):
    """What became of one member of the batch."""

    OK = 0
    NOT_FINITE = 1
    """The flow or the measurement model overflowed or returned NaN."""
    COLLAPSED = 2
    """A variance is not positive, or the innovation covariance is singular."""
    DIVERGED = 3
    """The gate rejected too many measurements in a row."""


class Gate(NamedTuple):
    """Chi-square gate on whole measurement rows.

    Attributes:
        probability: a row is rejected when its NIS exceeds this quantile of the chi-square law.
        patience: this many rejections in a row end in `Status.DIVERGED`.
    """

    probability: float = 0.9999
    patience: int = 5
