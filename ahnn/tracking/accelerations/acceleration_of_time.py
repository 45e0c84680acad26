"""Acceleration as a sum of functions of time: polynomials or a learned spline."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from ahnn.tracking.accelerations.contract import NONE, Acceleration, Array, inner

Axes = Literal["inertial", "orbital"]
LETTERS: dict[str, str] = {"inertial": "XYZ", "orbital": "RTN"}
"""Axes X, Y, Z of GCRF; or radial, along-track and cross-track."""


class TimeBasis(Protocol):
    """Basis functions of time."""

    size: int
    unit: float
    """Acceleration in km/s^2 for a weight of 1 and a function value of 1."""

    def __call__(self, t: Array) -> Array:
        """Return the functions at times (T,), shape (T, size)."""
        ...


class Powers:
    """Powers of the time since an origin, in units of the segment's length: 1, s, s^2, ..."""

    def __init__(self, origin: float, length: float, degree: int, unit: float = 1e-9) -> None:
        self.origin, self.length, self.size, self.unit = origin, length, degree + 1, unit

    def __call__(self, t: Array) -> Array:
        """Return the powers at times (T,), shape (T, size)."""
        s = (np.asarray(t, dtype=np.float64) - self.origin) / self.length
        return np.column_stack([s**k for k in range(self.size)])


class CubicSplines:
    """Cubic B-splines on equidistant knots (de Boor 1978); their sum is 1 between first and last time."""

    def __init__(self, first: float, last: float, pieces: int, unit: float = 1e-9) -> None:
        self.first, self.last, self.size, self.unit = first, last, pieces + 3, unit
        self.spacing = (last - first) / pieces

    def __call__(self, t: Array) -> Array:
        """Return the splines at times (T,), shape (T, size); clamped outside the span."""
        at = (np.clip(np.asarray(t, dtype=np.float64), self.first, self.last) - self.first) / self.spacing
        piece = np.minimum(at.astype(np.int64), self.size - 4)
        s = at - piece
        rest = 1 - s
        four = (rest**3, 3 * s**3 - 6 * s**2 + 4, 3 * rest**3 - 6 * rest**2 + 4, s**3)
        values, rows = np.zeros((len(at), self.size)), np.arange(len(at))
        for k, part in enumerate(four):
            values[rows, piece + k] = part / 6
        return values

    @property
    def centres(self) -> Array:
        """Time of each spline's maximum, (size,)."""
        return self.first + self.spacing * np.arange(-1.0, self.size - 1.0)


class AccelerationOfTime:
    """Sum of basis functions in three axes; the parameters are weights, in units of the basis.

    Args:
        basis: functions of time.
        axes: axes of the acceleration.
        name: prefix of parameter names.
    """

    def __init__(self, basis: TimeBasis, axes: Axes, name: str = "acceleration") -> None:
        self.basis, self.axes = basis, axes
        self.parameters = tuple(f"{name} {letter}{k}" for letter in LETTERS[axes] for k in range(basis.size))

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration at a state; derivatives neglect the rotation of orbital axes."""
        values = self.basis.unit * self.basis(np.array([t]))[0]
        inertial = self.axes == "inertial"
        frame = np.broadcast_to(np.eye(3), (*r.shape, 3)) if inertial else orbital_axes(r, v)
        by_parameters = (frame[..., None] * values).reshape(*frame.shape[:-1], -1)
        return Acceleration((by_parameters @ p[..., None])[..., 0], NONE, NONE, by_parameters)


def orbital_axes(r: Array, v: Array) -> Array:
    """Return the radial, along-track and cross-track unit vectors as columns, (..., 3, 3)."""
    normal = np.cross(r, v)
    outward, normal = (one / np.sqrt(inner(one, one)) for one in (r, normal))
    return np.stack((outward, np.cross(normal, outward), normal), axis=-1)
