"""Size and smoothness of a learned acceleration by maximum evidence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.unknowns import Smoothness, Unknowns
from ahnn.tracking.whitened_rows import WhitenedRows

Array = NDArray[np.float64]
DEVIATIONS = np.geomspace(1e-2, 1e3, 21)
"""Candidate standard deviations, in units of the basis."""
LENGTHS = np.geomspace(0.1, 10.0, 13)
"""Candidate length scales, as fractions of the time between the first and the last spline."""


def chosen_smoothness(
    unknowns: Unknowns, rows: WhitenedRows, weights: Array, x: Array, before: Smoothness
) -> Smoothness:
    """Return the smoothness of maximum evidence on a grid.

    For normal noise and measurements linearised about a point, the evidence follows Rasmussen & Williams
    (2006), 5.8, up to terms that do not depend on the smoothness.

    Args:
        unknowns: unknowns with the blocks of learned weights.
        rows: whitened, linearised measurements.
        weights: weights of a robust loss, (M,).
        x: linearisation point, (Q,).
        before: smoothness that is returned if no acceleration is learned.
    """
    if not unknowns.smooth:
        return before
    basis = unknowns.smooth[0].basis
    square = rows.by.T @ (weights[:, None] * rows.by)
    # Information vector for the unknowns themselves, rather than for a step from the linearisation point x.
    free = unknowns.free
    pull = rows.by.T @ (weights * (rows.e + rows.by @ (x - unknowns.mean)[free]))
    found = []
    for length in LENGTHS * (basis.last - basis.first):
        for deviation in DEVIATIONS:
            smooth = Smoothness(float(deviation), float(length))
            prior = unknowns.precision(smooth)[np.ix_(free, free)]
            found.append((evidence(square, pull, prior, unknowns, smooth), smooth))
    return max(found, key=lambda one: one[0])[1]


def evidence(square: Array, pull: Array, prior: Array, unknowns: Unknowns, smooth: Smoothness) -> float:
    """Return the logarithm of the evidence up to a constant."""
    normal = square + prior
    scale = 1 / np.sqrt(np.diagonal(square) + np.diagonal(prior))
    factor = np.linalg.cholesky(normal * scale * scale[:, None])
    gain = np.linalg.solve(factor, pull * scale)
    volume = 2 * np.log(np.diagonal(factor)).sum() - 2 * np.log(scale).sum()
    own = sum(np.linalg.slogdet(block.precision(smooth))[1] for block in unknowns.smooth)
    return float(0.5 * (gain @ gain + own - volume))
