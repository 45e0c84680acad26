"""Estimation of measurement noise from the residuals of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ahnn.shooting.robust import HUBER
from ahnn.tracking.whitened_rows import WhitenedRows

Array = NDArray[np.float64]
SMALLEST, MOST = 0.05, 10.0
"""Limits on the ratio of a noise estimate to the previous one."""
FEWEST = 10
"""Minimum number of measurements of a station for its own scatter estimate."""
CONSISTENT = float((2 * norm.cdf(HUBER) - 1) - 2 * HUBER * norm.pdf(HUBER) + 2 * HUBER**2 * norm.sf(HUBER))
"""Mean of min(e^2, HUBER^2) for normal e."""


def huber_weights(e: Array) -> Array:
    """Return the weights of Huber's loss for residuals in standard deviations, (M,)."""
    return HUBER / np.maximum(np.abs(e), HUBER)


def noise_deviations_of(
    rows: WhitenedRows, weights: Array, covariance: Array, noise: Array, *, robust: bool
) -> Array:
    """Estimate the noise by station and kind, (stations, 6), consistent with the residuals.

    A common factor on the noise of each kind makes the sum of psi(e)^2 equal to its mean for normal e times
    the redundancy, i.e. the number of measurements minus those that determine the unknowns (Huber 1981,
    proposal 2; Förstner 1979 for the redundancy of a group).

    Args:
        rows: fitted measurements.
        weights: weights of a robust loss, (M,).
        covariance: covariance of the free unknowns.
        noise: previous estimate.
        robust: whether to use Huber's psi.
    """
    kind = rows.group % noise.shape[1]
    spent = np.einsum("mf,fg,mg->m", rows.by, covariance, rows.by) * weights
    factors = np.ones_like(noise)
    for k in np.unique(kind):
        own = kind == k
        redundancy = max(own.sum() - spent[own].sum(), 1.0)
        mean = np.sum((weights[own] * rows.e[own]) ** 2) / redundancy
        factors[:, k] = np.clip(np.sqrt(mean / (CONSISTENT if robust else 1.0)), SMALLEST, MOST)
    return noise * factors


def scatter_of(residuals: Array, station: NDArray[np.int64], used: NDArray[np.bool_], noise: Array) -> Array:
    """Return root mean squares of residuals by station and kind, (stations, 6).

    Args:
        residuals: (N, 6), NaN where missing.
        station: (N,) station index of each measurement.
        used: (N,) mask of fitted measurements.
        noise: (stations, 6), used if nothing was fitted.
    """
    table = noise.copy()
    for k in range(noise.shape[1]):
        seen = used & np.isfinite(residuals[:, k])
        for s in range(len(noise)):
            own = seen & (station == s)
            own = own if own.sum() >= FEWEST else seen
            if own.any():
                table[s, k] = np.sqrt(np.mean(residuals[own, k] ** 2))
    return table
