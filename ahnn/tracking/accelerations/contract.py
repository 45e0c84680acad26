"""Interface of satellite accelerations."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NONE = np.zeros((3, 3))


class Acceleration(NamedTuple):
    """Acceleration at one or several states, in km/s^2 and the axes of GCRF.

    Attributes:
        value: (..., 3).
        by_position: derivative with respect to the position, (..., 3, 3).
        by_velocity: derivative with respect to the velocity, (..., 3, 3); (3, 3) if it is zero.
        by_parameters: derivative with respect to the parameters of the term, (..., 3, P); (3, 0) if there are
            none.
    """

    value: Array
    by_position: Array
    by_velocity: Array
    by_parameters: Array


class AccelerationTerm(Protocol):
    """Term of the acceleration."""

    parameters: tuple[str, ...]
    """Names of the parameters that can be estimated, with units in the term's docstring."""

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration of a satellite.

        Args:
            t: seconds after the epoch.
            r: position, (..., 3) km in GCRF.
            v: velocity, (..., 3) km/s.
            p: parameters, (..., P).
        """
        ...


def known(value: Array, by_position: Array, by_velocity: Array = NONE) -> Acceleration:
    """Build an acceleration without parameters."""
    return Acceleration(value, by_position, by_velocity, np.empty((3, 0)))


def inner(a: Array, b: Array) -> Array:
    """Return the scalar products of vectors (..., 3), shape (..., 1)."""
    return np.asarray((a * b).sum(-1, keepdims=True))


def outer(a: Array, b: Array) -> Array:
    """Return the matrices a b^T of vectors (..., 3), shape (..., 3, 3)."""
    return a[..., :, None] * b[..., None, :]
