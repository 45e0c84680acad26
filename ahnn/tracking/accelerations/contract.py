"""Interface of satellite accelerations."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NONE = np.zeros((3, 3))


class Acceleration(NamedTuple):
    """Acceleration at one state, in km/s^2 in GCRF, with derivatives.

    Attributes:
        value: (3,) acceleration.
        by_position: derivatives with respect to position, (3, 3).
        by_velocity: derivatives with respect to velocity, (3, 3).
        by_parameters: derivatives with respect to the term's parameters, (3, P).
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
            r: position, (3,) km in GCRF.
            v: velocity, (3,) km/s.
            p: parameters, (P,).
        """
        ...


def known(value: Array, by_position: Array, by_velocity: Array = NONE) -> Acceleration:
    """Build an acceleration without parameters."""
    return Acceleration(value, by_position, by_velocity, np.empty((3, 0)))
