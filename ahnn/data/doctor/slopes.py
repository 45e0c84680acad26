"""Derivatives of samples and how far they can be trusted, from polynomials through neighbouring samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.samples import Array

CENTRES = 64
"""Samples of a trajectory at which derivatives are taken."""
LEAST = 12
"""Derivatives that a longer stride has to leave, so that none is chosen by chance."""
WIDE = 3.0
"""A stencil so many times wider than most lies across a gap."""


CLOSE = 1e-12
"""Distance of two samples, as a fraction of a stencil, within which no polynomial goes through both."""


class Slopes(NamedTuple):
    """Derivatives of samples, and how much stencils of three and of five points differ in them.

    Attributes:
        at: (K,) numbers of the samples.
        values, doubts: (K, C).
    """

    at: NDArray[np.int64]
    values: Array
    doubts: Array

    @property
    def doubt(self) -> float:
        """Typical doubt relative to the typical size."""
        sizes = [np.linalg.norm(part, axis=1) for part in (self.doubts, self.values)]
        known = np.isfinite(sizes[0])
        if not known.any():
            return math.inf
        doubt, size = (float(np.median(part[known])) for part in sizes)
        return doubt / size if size > 0 else math.inf


def slopes(times: Array, values: Array, order: int) -> Slopes | None:
    """Return derivatives over the stride that makes three and five points differ least.

    Near neighbours show the noise, far ones the curvature of the motion; where neither is small the doubts
    say so. None where there are fewer than seven samples.

    Args:
        times: (T,), increasing.
        values: (T, C), NaN where a number is missing.
        order: 1 or 2.
    """
    if len(times) < 7:
        return None
    strides = [1, *(2**k for k in range(1, 12) if 4 * 2**k + LEAST <= len(times))]
    found = [over(times, values, stride, order) for stride in strides]
    return min(found, key=lambda one: one.doubt)


def over(times: Array, values: Array, stride: int, order: int) -> Slopes:
    """Return derivatives from samples so many apart."""
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

    NaN where two of the points, which are in their order, meet.
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
    """Return how far samples (K, C) are from the cubic through the two before and the two behind them."""
    return np.abs(through_neighbours(times, values, at, 2) - values[at])


def through_neighbours(times: Array, values: Array, at: NDArray[np.int64], count: int) -> Array:
    """Return what the polynomials through so many samples before and behind others say of them, (K, C)."""
    window = at[:, None] + np.delete(np.arange(-count, count + 1), count)
    offsets = times[window] - times[at, None]
    return np.einsum("kj,kjc->kc", weights(offsets, 0), values[window])
