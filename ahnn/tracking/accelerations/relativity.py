"""Relativistic correction of the Earth's attraction (IERS Conventions 2010, 10.12, the first term)."""

from __future__ import annotations

import numpy as np

from ahnn.tracking.accelerations.contract import Acceleration, Array, known

LIGHT = 299792.458
"""Speed of light, km/s."""


class SchwarzschildTerm:
    """Schwarzschild term mu / (c^2 r^3) ((4 mu / r - v^2) r + 4 (r v) v).

    Args:
        mu: gravitational parameter of the Earth, km^3/s^2.
    """

    parameters: tuple[str, ...] = ()

    def __init__(self, mu: float) -> None:
        self.mu = mu

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration at a state; see `AccelerationTerm`."""
        del t, p
        distance, along = np.linalg.norm(r), r @ v
        factor = self.mu / (LIGHT**2 * distance**3)
        inner = 4 * self.mu / distance - v @ v
        value = factor * (inner * r + 4 * along * v)
        slope = inner * np.eye(3) - 4 * self.mu / distance**3 * np.outer(r, r) + 4 * np.outer(v, v)
        by_position = factor * slope - 3 * np.outer(value, r) / distance**2
        by_velocity = factor * (4 * along * np.eye(3) - 2 * np.outer(r, v) + 4 * np.outer(v, r))
        return known(value, by_position, by_velocity)
