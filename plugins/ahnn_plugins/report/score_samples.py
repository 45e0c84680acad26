"""Samples of scores over runs, and ratios with confidence intervals."""

from __future__ import annotations

import math
import statistics
from typing import NamedTuple


class Sample(NamedTuple):
    """Scores of several runs with different seeds.

    Attributes:
        values: one per run; inf or NaN for diverged predictions.
    """

    values: tuple[float, ...]

    @property
    def finite(self) -> bool:
        """Whether every value is a finite number."""
        return all(map(math.isfinite, self.values))

    @property
    def mean(self) -> float:
        """Arithmetic mean; inf or NaN if any value is."""
        return sum(self.values) / len(self.values) if self.values else math.nan

    @property
    def spread(self) -> float | None:
        """Sample standard deviation, with n - 1; None for fewer than two or diverged runs."""
        return statistics.stdev(self.values) if len(self.values) > 1 and self.finite else None

    @property
    def logarithms(self) -> list[float] | None:
        """Natural logarithms; None unless all values are finite and above zero."""
        there = self.values and self.finite and min(self.values) > 0
        return [math.log(value) for value in self.values] if there else None

    @property
    def typical(self) -> float:
        """Geometric mean, used for rankings; inf or NaN for diverged predictions."""
        logarithms = self.logarithms
        return self.mean if logarithms is None else math.exp(statistics.fmean(logarithms))


class Ratio(NamedTuple):
    """Ratio of two scores.

    Attributes:
        value: ratio of the geometric means; NaN if unknown.
        low, high: limits of its confidence interval; 0 and inf for unknown spread.
    """

    value: float
    low: float = 0.0
    high: float = math.inf

    def within(self, low: float, high: float) -> bool:
        """Return whether the entire interval lies in [low, high]."""
        return low <= self.low and self.high <= high

    def beyond(self, low: float, high: float) -> bool:
        """Return whether the entire interval lies outside [low, high]."""
        return self.high < low or high < self.low


def ratio(one: Sample, other: Sample, confidence: float) -> Ratio:
    """Compute the ratio of two scores.

    Errors scatter by factors, so Welch's test (1947) is applied to their logarithms: standard error
    sqrt(s1^2/n1 + s2^2/n2), degrees of freedom by Satterthwaite (1946).

    Args:
        one: numerator.
        other: denominator.
        confidence: level of the two-sided interval, such as 0.95.
    """
    a, b = one.logarithms, other.logarithms
    if a is None or b is None:
        return _lost(one, other)
    value = _power(statistics.fmean(a) - statistics.fmean(b))
    if len(a) < 2 or len(b) < 2:
        return Ratio(value)
    parts = [statistics.variance(logarithms) / len(logarithms) for logarithms in (a, b)]
    if not sum(parts):
        return Ratio(value, value, value)
    weights = [part / sum(parts) for part in parts]
    freedom = 1 / sum(w * w / (len(x) - 1) for w, x in zip(weights, (a, b), strict=True))
    width = _power(_quantile(confidence, freedom) * math.sqrt(sum(parts)))
    return Ratio(value, value / width, value * width)


def _power(logarithm: float) -> float:
    """Return e to a power, inf on overflow."""
    try:
        return math.exp(logarithm)
    except OverflowError:
        return math.inf


def _quantile(confidence: float, freedom: float) -> float:
    """Return the quantile of Student's t for a two-sided interval."""
    from scipy.special import stdtrit  # import takes a tenth of a second and is needed only for comparisons

    return float(stdtrit(freedom, 0.5 + confidence / 2))


def _lost(one: Sample, other: Sample) -> Ratio:
    """Return a ratio with diverged runs: known only if all of one sample and none of the other diverged."""
    if one.values and other.values:
        lost = [[not math.isfinite(value) for value in sample.values] for sample in (one, other)]
        enough = min(map(len, lost)) > 1
        if all(lost[0]) and not any(lost[1]):
            return Ratio(math.inf, math.inf if enough else 0.0)
        if all(lost[1]) and not any(lost[0]):
            return Ratio(0.0, 0.0, 0.0 if enough else math.inf)
    return Ratio(math.nan)
