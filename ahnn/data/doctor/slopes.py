"""Derivatives of samples and their uncertainty, from polynomials through neighbouring samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.samples import Array

CENTRES = 64
"""Number of samples of a trajectory where derivatives are computed."""
LEAST = 12
"""Minimum number of derivatives for a longer stride, so that none is chosen by chance."""
RISEN = 2.0
"""Increase of the uncertainty that ends the search for a stride; a smaller one may be chance."""
WIDE = 3.0
"""Multiple of the typical width above which a stencil spans a gap."""


CLOSE = 1e-12
"""Minimum distance of two samples, as a fraction of a stencil, for a polynomial through both."""


class Slopes(NamedTuple):
    """Derivatives of samples, and differences between three- and five-point stencils.

    Attributes:
        at: (K,) sample indices.
        values, doubts: (K, C) derivatives and their uncertainties.
    """

    at: NDArray[np.int64]
    values: Array
    doubts: Array

    @property
    def doubt(self) -> float:
        """Typical uncertainty relative to the typical size."""
        sizes = [np.linalg.norm(part, axis=1) for part in (self.doubts, self.values)]
        known = np.isfinite(sizes[0])
        if not known.any():
            return math.inf
        doubt, size = (float(np.median(part[known])) for part in sizes)
        return doubt / size if size > 0 else math.inf


def slopes(times: Array, values: Array, order: int) -> Slopes | None:
    """Return derivatives for the stride at which three- and five-point stencils differ least.

    Short strides amplify noise, long ones the error due to curvature; the uncertainties include both. Strides
    beyond the first minimum are not tried: of a period of the motion, they would see only a slow drift.
    Returns None for fewer than seven samples.

    Args:
        times: (T,) increasing times.
        values: (T, C) values, NaN where missing.
        order: order of the derivative, 1 or 2.
    """
    if len(times) < 7:
        return None
    best = over(times, values, 1, order)
    for stride in (2**k for k in range(1, 12) if 4 * 2**k + LEAST <= len(times)):
        longer = over(times, values, stride, order)
        if longer.doubt > RISEN * best.doubt:
            break
        best = min(best, longer, key=lambda one: one.doubt)
    return best


def over(times: Array, values: Array, stride: int, order: int) -> Slopes:
    """Return derivatives from samples at a given stride."""
    inner = np.arange(2 * stride, len(times) - 2 * stride)
    at = inner[:: max(1, len(inner) // CENTRES)]
    window = at[:, None] + stride * np.arange(-2, 3)
    offsets = times[window] - times[at, None]
    width = offsets[:, -1] - offsets[:, 0]
    near = width <= WIDE * np.median(width)
    at, window, offsets = at[near], window[near], offsets[near]
    five = np.einsum("kj,kjc->kc", weights(offsets, order), values[window])
    three = np.einsum("kj,kjc->kc", weights(offsets[:, 1:4], order), values[window[:, 1:4]])
    return Slopes(at, five, np.abs(five - three))


def weights(offsets: Array, order: int) -> Array:
    """Return weights (K, P) of a derivative at zero of the polynomials through points at offsets (K, P).

    NaN where two of the ordered points coincide.
    """
    size = np.abs(offsets).max(axis=1, keepdims=True)
    powers = (offsets / size)[:, None, :] ** np.arange(offsets.shape[1])[:, None]
    unit = np.zeros((offsets.shape[1], 1))
    unit[order] = math.factorial(order)
    met = np.diff(offsets, axis=1).min(axis=1) < CLOSE * size[:, 0]
    powers[met] = np.eye(offsets.shape[1])
    found = np.linalg.solve(powers, unit[None])[..., 0] / size**order
    found[met] = np.nan
    return found


def roughness(times: Array, values: Array, at: NDArray[np.int64]) -> Array:
    """Return the distance of samples (K, C) from the cubic through two neighbours on each side."""
    return np.abs(interpolated(times, values, at, 2)[0] - values[at])


def interpolated(times: Array, values: Array, at: NDArray[np.int64], count: int) -> tuple[Array, Array]:
    """Return values of polynomials through neighbours on both sides, (K, C), and weights, (K, 2 count)."""
    window = at[:, None] + np.delete(np.arange(-count, count + 1), count)
    of_neighbours = weights(times[window] - times[at, None], 0)
    return np.einsum("kj,kjc->kc", of_neighbours, values[window]), of_neighbours
