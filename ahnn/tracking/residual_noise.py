"""The noise of measurements, estimated from the residuals of a fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ahnn.shooting.robust import HUBER

if TYPE_CHECKING:
    from ahnn.tracking.orbit_fit import WhitenedRows

Array = NDArray[np.float64]
SMALLEST, MOST = 0.05, 10.0
"""A noise is at least this fraction, and at most this multiple, of what it was a step before."""
FEWEST = 10
"""Measurements of a station from which it has a scatter of its own."""
CONSISTENT = float((2 * norm.cdf(HUBER) - 1) - 2 * HUBER * norm.pdf(HUBER) + 2 * HUBER**2 * norm.sf(HUBER))
"""Mean of min(e^2, HUBER^2) of a normal e."""


def huber_weights(e: Array) -> Array:
    """Return the weights of Huber's loss of residuals in standard deviations, (M,)."""
    return HUBER / np.maximum(np.abs(e), HUBER)


def noise_deviations_of(
    rows: WhitenedRows, weights: Array, covariance: Array, noise: Array, *, robust: bool
) -> Array:
    """Return the noise by station and kind, (stations, 6), that makes residuals as large as they should be.

    Of each group: the sum of psi(e)^2 is its mean for a normal e times the number of measurements less those
    that determine the unknowns (Huber 1981, proposal 2; Förstner 1979 for the redundancy of a group).

    Args:
        rows: fitted measurements.
        weights: of a robust loss, (M,).
        covariance: of the free unknowns.
        noise: a step before.
        robust: whether psi is that of Huber.
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
        residuals: (N, 6), NaN where nothing was measured.
        station: (N,) place of each measurement's station.
        used: (N,) which were fitted.
        noise: (stations, 6), taken where nothing was fitted at all.
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
