"""Third-body perturbation: attraction of the satellite minus attraction of the Earth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ahnn.tracking.accelerations.contract import Acceleration, Array, inner, known, outer


class ThirdBody:
    """Attraction by Sun or Moon as a point mass (Montenbruck & Gill, Satellite Orbits, 3.37).

    Args:
        mu: gravitational parameter, km^3/s^2.
        position: t -> (3,) geocentric position, km.
    """

    parameters: tuple[str, ...] = ()

    def __init__(self, mu: float, position: Callable[[float], Array]) -> None:
        self.mu, self.position = mu, position

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the attraction at a state; see `AccelerationTerm`."""
        body = self.position(t)
        line = body - r
        distance = np.sqrt(inner(line, line))
        value = self.mu * (line / distance**3 - body / np.linalg.norm(body) ** 3)
        cube = distance[..., None] ** 3
        tensor = self.mu * (3 * outer(line / distance, line / distance) - np.eye(3)) / cube
        return known(value, tensor)
