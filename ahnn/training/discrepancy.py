"""How wrong a field still is, as a share of itself, so that residuals weigh what they say.

Early in a training the field misses by a share of what it predicts, not by a multiple of the noise: where
forces are large, residuals are thousands of deviations, and least squares in deviations would look nowhere
else. With the share e unknown, a sum with noise of variance c, to which the field contributes g, has the
variance

    c + e^2 g^2,

and e is what makes the residuals as large as such noise: as in Paule & Mandel 1982 (J. Res. NBS 87, 377-385),
but by the median, which outliers do not move. As the field improves e falls, and where residuals are noise it
is zero: what is minimised then is chi-square.
"""

from __future__ import annotations

from torch import Tensor

MEDIAN = 0.6745
"""Of |z|, z normal of unit variance."""
SMALLEST, LARGEST = 1e-9, 1e3
"""Range of the share; residuals that ask for less than the smallest are noise."""
HALVINGS = 40
"""Bisections of its logarithm."""


def share(residuals: Tensor, effects: Tensor, noise: Tensor, there: Tensor) -> float:
    """Return e, at least 0, under which half of the residuals are within `MEDIAN` deviations.

    Args:
        residuals: of sums, shape (B, J, M), in standard deviations of single measurements.
        effects: g^2, (B, J, M), squares of what the field contributes.
        noise: c, (B, J, M) or (1, J, M), variances of the sums of unit noise.
        there: (B, J) or (1, J) bool, whether a sum is there.
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
