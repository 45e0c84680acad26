"""Vector of unknowns of an orbit determination, with priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.accelerations.acceleration_of_time import CubicSplines

Array = NDArray[np.float64]
START = ("x", "y", "z", "vx", "vy", "vz")
NUGGET = 1e-6
"""Relative jitter on the diagonal of a smooth function's prior covariance before inversion."""


class Smoothness(NamedTuple):
    """Expected size and time scale of a learned acceleration.

    Attributes:
        deviation: standard deviation of its values, in units of the basis.
        length: correlation time, s.
    """

    deviation: float
    length: float


class SmoothBlock(NamedTuple):
    """Weights of a learned acceleration among the unknowns.

    Attributes:
        first: index of the first weight.
        basis: spline basis; the weights of the three axes are consecutive.
    """

    first: int
    basis: CubicSplines

    @property
    def places(self) -> slice:
        """Indices of the weights."""
        return slice(self.first, self.first + 3 * self.basis.size)

    def precision(self, smooth: Smoothness) -> Array:
        """Return the inverse of the prior covariance of the weights, (3 K, 3 K).

        The prior is a Gaussian process with the Matern covariance of order 5/2 (Rasmussen & Williams 2006,
        4.17) at the centres of the splines, equal and independent for each axis.
        """
        apart = np.abs(np.subtract.outer(self.basis.centres, self.basis.centres)) * np.sqrt(5) / smooth.length
        covariance = smooth.deviation**2 * (1 + apart + apart**2 / 3) * np.exp(-apart)
        covariance += NUGGET * smooth.deviation**2 * np.eye(self.basis.size)
        return np.kron(np.eye(3), np.linalg.inv(covariance))


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Vector of initial state, force parameters and biases, with priors.

    Attributes:
        names: names of all unknowns, (Q,).
        mean: prior mean, (Q,); fixed value of unknowns that are not estimated.
        deviations: prior standard deviations, (Q,): 0 fixes the value, infinity means no prior.
        forces: number of force parameters.
        bias: (station, kind) indices of each bias in the data.
        smooth: learned accelerations, with a `Smoothness` as prior.
    """

    names: tuple[str, ...]
    mean: Array
    deviations: Array
    forces: int
    bias: tuple[tuple[int, int], ...]
    smooth: tuple[SmoothBlock, ...] = ()

    @property
    def free(self) -> NDArray[np.bool_]:
        """Mask of estimated unknowns, (Q,)."""
        return self.deviations > 0

    def precision(self, smooth: Smoothness | None) -> Array:
        """Return the inverse of the prior covariance of all unknowns, (Q, Q); 0 without a prior."""
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
