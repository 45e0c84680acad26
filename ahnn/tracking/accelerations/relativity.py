"""Relativistic correction of the Earth's attraction (IERS Conventions 2010, 10.12, the first term)."""

from __future__ import annotations

import numpy as np

from ahnn.tracking.accelerations.contract import Acceleration, Array, inner, known, outer

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
        distance, along = np.sqrt(inner(r, r)), inner(r, v)
        factor = self.mu / (LIGHT**2 * distance**3)
        radial = 4 * self.mu / distance - inner(v, v)
        value = factor * (radial * r + 4 * along * v)
        slope = radial[..., None] * np.eye(3) - 4 * self.mu * outer(r / distance**3, r) + 4 * outer(v, v)
        by_position = factor[..., None] * slope - 3 * outer(value / distance**2, r)
        by_velocity = factor[..., None] * (
            4 * along[..., None] * np.eye(3) - 2 * outer(r, v) + 4 * outer(v, r)
        )
        return known(value, by_position, by_velocity)
