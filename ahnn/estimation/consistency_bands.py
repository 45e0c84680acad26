"""Means of NEES and NIS, with the acceptance bands of a consistent filter."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.consistency import band, independent_count
from ahnn.estimation.results import FilterResult


class Judged(NamedTuple):
    """Mean over members and times, with its 95 % band for a consistent filter."""

    mean: float
    limits: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Whether the mean lies in its band."""
        return self.limits[0] <= self.mean <= self.limits[1]

    def __str__(self) -> str:
        """Format mean, verdict and band."""
        low, high = self.limits
        return f"{self.mean:.3g} {'in' if self.inside else 'not in'} {low:.3g} to {high:.3g}"

    def of_exact_starts(self) -> str:
        """Return the mean of a filter with exact start, without verdict: the mean is then biased low."""
        low, high = self.limits
        return f"{self.mean:.3g} below {low:.3g} to {high:.3g}" if self.mean < low else str(self)


def judged_nees(values: Tensor, degrees: int) -> Judged:
    """Return the mean of NEES (B, T), NaN where ignored.

    The NEES is correlated in time: the band uses `independent_count` values.
    """
    return Judged(float(values.nanmean()), band(degrees, independent_count(values)))


def judged_nis(result: FilterResult) -> Judged:
    """Return the mean NIS over accepted rows of all members and times.

    Innovations are white: the sum is chi-square with as many degrees of freedom as measured numbers.
    """
    values = result.nis.masked_fill(result.rejected, torch.nan)
    there = values.isfinite()
    count = int(there.sum())
    if count == 0:
        return Judged(float("nan"), (float("nan"), float("nan")))
    degrees = float(result.measured[there].double().mean())
    return Judged(float(values.nanmean()), band(degrees, count))
