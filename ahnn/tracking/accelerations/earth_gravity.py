"""The Earth's gravity: spherical harmonics in Earth-fixed axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ahnn.systems.gravity import GravityField
from ahnn.systems.gravity.harmonics import gradient, in_a_row
from ahnn.tracking.accelerations.contract import Acceleration, Array, known
from ahnn.tracking.earth_rotation import EarthRotation


class EarthGravity:
    """Attraction by a static field.

    Args:
        field: gravity field with coefficients in ITRF.
        rotation: rotation from GCRF to ITRF.
    """

    parameters: tuple[str, ...] = ()

    def __init__(self, field: GravityField, rotation: EarthRotation) -> None:
        self.field, self._rotation = field, rotation
        first = gradient(field.cosines, field.sines)
        second = [part for one in first for part in gradient(*one)]
        wide = [tuple(np.pad(part, ((0, 1), (0, 1))) for part in one) for one in first]  # equal length
        self._series = np.stack([in_a_row(*part).numpy() for part in (*wide, *second)], -1)
        self._recursion = recursion(field.degree + 2, min(field.order, field.degree) + 2)

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the attraction at a state; see `AccelerationTerm`."""
        turn = self._rotation.matrices(np.array([t]))[0]
        field = self.field
        series = harmonics_at(r @ turn.T, field.radius, self._recursion).view(np.float64) @ self._series
        value = field.mu / field.radius**2 * series[..., :3]
        tensor = field.mu / field.radius**3 * series[..., 3:].reshape(*r.shape, 3)
        return known(value @ turn, turn.T @ tensor @ turn)


Recursion = tuple[tuple[Array, Array, float], ...]
"""For each degree from 1: factors on z times the previous degree, on the one before that, and on x + i y."""


def recursion(degree: int, order: int) -> Recursion:
    """Return the recursion factors of `ahnn.systems.gravity.harmonics` for `harmonics_at`."""
    found = []
    for n in range(1, degree + 1):
        m = np.arange(min(n - 1, order) + 1)
        both = (n - m) * (n + m)
        along = np.sqrt((2 * n - 1) * (2 * n + 1) / both)
        before = np.sqrt(np.maximum((2 * n + 1) * (n + m - 1) * (n - m - 1), 0) / (both * abs(2 * n - 3)))
        across = 3**0.5 if n == 1 else ((2 * n + 1) / (2 * n)) ** 0.5
        found.append((along, before, across if n <= order else 0.0))
    return tuple(found)


def harmonics_at(q: Array, radius: float, factors: Recursion) -> NDArray[np.complexfloating]:
    """Return V_nm + i W_nm, (..., K), at points (..., 3).

    `solid_harmonics` uses torch; on a path, which is propagated point by point, numpy is eight times as fast.
    """
    lead = q.shape[:-1]
    inverse = 1 / (q * q).sum(-1, keepdims=True) if lead else 1 / (q @ q)
    x, y, z = np.moveaxis((radius * inverse * q)[..., None], -2, 0) if lead else radius * inverse * q
    across, square = x + 1j * y, radius**2 * inverse
    rows = [np.sqrt(square) + np.zeros(1, dtype=np.complex128)]
    for n, (along, before, sectoral) in enumerate(factors, 1):
        last, count = rows[-1], len(along)
        row = np.empty((*lead, count + (sectoral > 0)), dtype=np.complex128)
        np.multiply(along * z, last[..., :count], out=row[..., :count])
        if n > 1:
            older = rows[-2]
            size = older.shape[-1]
            row[..., :count][..., :size] -= (square * before)[..., :size] * older[..., :count]
        if sectoral:
            row[..., -1:] = sectoral * across * last[..., -1:]
        rows.append(row)
    return np.concatenate(rows, axis=-1)
