"""What an orbit determination estimates, in one vector, with what is known of it before the measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.accelerations.acceleration_of_time import CubicSplines

Array = NDArray[np.float64]
START = ("x", "y", "z", "vx", "vy", "vz")
NUGGET = 1e-6
"""Of the variance, on the diagonal of a smooth function's prior covariance, which is then inverted."""


class Smoothness(NamedTuple):
    """How large and how fast a learned acceleration is expected to be.

    Attributes:
        deviation: standard deviation of its values, in units of the basis.
        length: time over which it changes, s.
    """

    deviation: float
    length: float


class SmoothBlock(NamedTuple):
    """The weights of a learned acceleration among the unknowns.

    Attributes:
        first: place of the first.
        basis: the splines; three axes of so many weights follow one another.
    """

    first: int
    basis: CubicSplines

    @property
    def places(self) -> slice:
        """Where its weights stand."""
        return slice(self.first, self.first + 3 * self.basis.size)

    def precision(self, smooth: Smoothness) -> Array:
        """Return the inverse of the prior covariance of its weights, (3 K, 3 K).

        That of a Gaussian process with the Matern covariance of order 5/2 (Rasmussen & Williams 2006, 4.17)
        at the centres of the splines, the same and independent for each axis.
        """
        apart = np.abs(np.subtract.outer(self.basis.centres, self.basis.centres)) * np.sqrt(5) / smooth.length
        covariance = smooth.deviation**2 * (1 + apart + apart**2 / 3) * np.exp(-apart)
        covariance += NUGGET * smooth.deviation**2 * np.eye(self.basis.size)
        return np.kron(np.eye(3), np.linalg.inv(covariance))


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The vector [start, parameters of the forces, biases] and which of it is estimated.

    Attributes:
        names: of all (Q,).
        mean: what each is expected to be, (Q,); those that are not estimated keep it.
        deviations: prior standard deviations, (Q,): 0 keeps the value, infinity knows nothing before.
        forces: how many parameters of the forces there are.
        bias: (station, kind) of each bias, places in the data.
        smooth: learned accelerations, whose prior is a `Smoothness` instead.
    """

    names: tuple[str, ...]
    mean: Array
    deviations: Array
    forces: int
    bias: tuple[tuple[int, int], ...]
    smooth: tuple[SmoothBlock, ...] = ()

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which are estimated, (Q,)."""
        return self.deviations > 0

    def precision(self, smooth: Smoothness | None) -> Array:
        """Return the inverse of the prior covariance of all, (Q, Q); 0 of what nothing is known of."""
        with np.errstate(divide="ignore"):
            matrix = np.diag(np.where(self.free, self.deviations, np.inf) ** -2.0)
        if smooth is not None:
            for block in self.smooth:
                matrix[block.places, block.places] = block.precision(smooth)
        return matrix

    def biases(self, x: Array, shape: tuple[int, int]) -> Array:
        """Return the biases by station and kind, (stations, 6)."""
        table = np.zeros(shape)
        for (station, kind), value in zip(self.bias, x[6 + self.forces :], strict=True):
            table[station, kind] = value
        return table
