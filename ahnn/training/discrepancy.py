"""Model discrepancy, relative to the field, as an additional variance of residuals.

Early in training the error of the field is proportional to the field, not to the noise: where forces are
large, residuals are thousands of standard deviations, and least squares weighted by noise would ignore all
other residuals. With an unknown relative error e, a sum with noise variance c and field contribution g has
variance

    c + e^2 g^2,

where e is chosen such that the residuals match this variance: as in Paule & Mandel 1982 (J. Res. NBS 87,
377-385), but with the median, which is robust to outliers. As the field improves, e decreases, and it
vanishes where residuals are noise: the objective is then chi-square.
"""

from __future__ import annotations

from torch import Tensor

MEDIAN = 0.6745
"""Median of |z| for standard normal z."""
SMALLEST, LARGEST = 1e-9, 1e3
"""Range of the relative error; smaller estimates are attributed to noise."""
HALVINGS = 40
"""Number of bisections of the logarithm of the relative error."""


def relative_error(residuals: Tensor, effects: Tensor, noise: Tensor, there: Tensor) -> float:
    """Return e >= 0 for which half of the residuals are within `MEDIAN` deviations.

    Args:
        residuals: residuals of sums, shape (B, J, M), in standard deviations of individual measurements.
        effects: g^2, (B, J, M), squared field contributions.
        noise: c, (B, J, M) or (1, J, M), variances of the sums for unit noise.
        there: (B, J) or (1, J) bool, whether a sum is available.
    """
    there = there.expand(residuals.shape[:2])
    residuals, effects, noise = (of[there] for of in (residuals, effects, noise.expand_as(effects)))

    def excess(e: float) -> bool:
        deviations = (noise + e * e * effects).sqrt()
        return float((residuals.abs() / deviations).median()) > MEDIAN

    if not bool(there.any()) or not excess(SMALLEST):
        return 0.0
    low, high = SMALLEST, LARGEST
    for _ in range(HALVINGS):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if excess(middle) else (low, middle)
    return high
