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
        """Format the mean of a filter with exact start, which biases it low: no verdict below the band."""
        low, high = self.limits
        return f"{self.mean:.3g} below {low:.3g} to {high:.3g}" if self.mean < low else str(self)


def judged_nees(values: Tensor, degrees: int) -> Judged:
    """Return the mean of NEES (B, T), NaN where ignored, with its band.

    The NEES is correlated in time: the band is that of `independent_count` values.
    """
    return Judged(float(values.nanmean()), band(degrees, independent_count(values)))


def judged_nis(result: FilterResult) -> Judged:
    """Return the mean NIS over accepted rows of all members and times, with its band.

    Innovations are white: the sum is chi-square with as many degrees of freedom as measured values.
    """
    values = result.nis.masked_fill(result.rejected, torch.nan)
    there = values.isfinite()
    count = int(there.sum())
    if count == 0:
        return Judged(float("nan"), (float("nan"), float("nan")))
    degrees = float(result.measured[there].double().mean())
    return Judged(float(values.nanmean()), band(degrees, count))


def nis_at_times(values: Tensor, measured: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the NIS per measured value at each time over all members, and its 95 % band, (T,) each.

    The sum of the NIS of all members is chi-square distributed, with as many degrees of freedom as measured
    values. Their number varies with time if a sensor does not measure all members.

    Args:
        values: (B, T) NIS, NaN where ignored.
        measured: (B, T) number of measured components.
    """
    counts = (measured * values.isfinite()).sum(0)
    known = {n: band(n, 1) for n in counts.unique().tolist() if n}
    limits = [[limit / n for limit in known[n]] if n else [torch.nan] * 2 for n in counts.tolist()]
    low, high = torch.tensor(limits, dtype=torch.float64).reshape(-1, 2).unbind(-1)
    return values.nansum(0) / counts, low, high
