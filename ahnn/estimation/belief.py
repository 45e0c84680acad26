"""Gaussian beliefs of all estimators, and the status of members."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import torch
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
    """Status of one member of the batch."""

    OK = 0
    NOT_FINITE = 1
    """The flow or the measurement model overflowed or returned NaN."""
    COLLAPSED = 2
    """A variance is not positive, or the innovation covariance is singular."""
    DIVERGED = 3
    """The gate rejected too many consecutive measurements."""
    IMPRECISE = 4
    """Rounding may exceed a fraction of a standard deviation: float64 is too coarse for such small noise."""


def choose(condition: Tensor, yes: Belief, no: Belief) -> Belief:
    """Select beliefs member by member; condition (B,) bool."""
    return Belief(
        torch.where(condition[:, None], yes.mean, no.mean),
        torch.where(condition[:, None, None], yes.chol, no.chol),
    )


def leading(belief: Belief, size: int) -> Belief:
    """Return the marginal of the leading components; its factor is the leading block of the lower factor."""
    return Belief(belief.mean[..., :size], belief.chol[..., :size, :size])
