"""Means of NEES and NIS, and the bands in which those of a consistent filter lie."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.consistency import band, independent_count
from ahnn.estimation.results import FilterResult


class Judged(NamedTuple):
    """A mean over members and times, and where it lies with 95 % for a consistent filter."""

    mean: float
    limits: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Whether the mean lies in its band."""
        return self.limits[0] <= self.mean <= self.limits[1]

    def __str__(self) -> str:
        """Return mean, verdict and band for a reader."""
        low, high = self.limits
        return f"{self.mean:.3g} {'in' if self.inside else 'not in'} {low:.3g} to {high:.3g}"

    def of_exact_starts(self) -> str:
        """Return the same of a filter whose start is exact, which makes a mean low and says nothing."""
        low, high = self.limits
        return f"{self.mean:.3g} below {low:.3g} to {high:.3g}" if self.mean < low else str(self)


def judged_nees(values: Tensor, degrees: int) -> Judged:
    """Return the mean of NEES (B, T), NaN where it does not count.

    The NEES is correlated in time: its values count as `independent_count` of them.
    """
    return Judged(float(values.nanmean()), band(degrees, independent_count(values)))


def judged_nis(result: FilterResult) -> Judged:
    """Return the mean NIS over accepted rows of all members and times.

    Innovations are white: the sum is chi-square with as many degrees of freedom as numbers were measured.
    """
    values = result.nis.masked_fill(result.rejected, torch.nan)
    there = values.isfinite()
    count = int(there.sum())
    if count == 0:
        return Judged(float("nan"), (float("nan"), float("nan")))
    degrees = float(result.measured[there].double().mean())
    return Judged(float(values.nanmean()), band(degrees, count))
