"""Estimates of a stream."""

from __future__ import annotations

from typing import Literal, NamedTuple

from torch import Tensor

from ahnn.assimilation.fixed_lag import LaggedEstimate
from ahnn.estimation import Innovation

Outcome = Literal["taken", "reopened", "rejected", "predicted", "repeated", "late", "ahead"]
"""Outcome of a reading: accepted, accepted with a widened belief, rejected by the gate, empty, duplicate, too
late, or too far ahead. The last three leave the estimate unchanged.
"""


class Estimate(NamedTuple):
    """Estimate after a reading.

    Attributes:
        outcome: outcome of the reading.
        time: time of the estimate and of the newest reading.
        mean: (D,).
        covariance: (D, D).
        innovation: innovation of the reading; None if the estimate did not change.
        replayed: number of later readings that were replayed.
        modes: probabilities of the modes of interacting models; () for other filters.
        smoothed: with a lag, the smoothed belief about the earlier time; None if unavailable.
    """

    outcome: Outcome
    time: float
    mean: Tensor
    covariance: Tensor
    innovation: Innovation | None
    replayed: int = 0
    modes: tuple[float, ...] = ()
    smoothed: LaggedEstimate | None = None


def covariances(chol: Tensor) -> Tensor:
    """Return the covariances (..., D, D) of factors, bit-identical whether computed alone or in a batch."""
    total, *others = [part.unsqueeze(-1) * part.unsqueeze(-2) for part in chol.unbind(-1)]
    for other in others:
        total = total + other
    return total
