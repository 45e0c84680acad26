"""Drag of an atmosphere that rotates with the Earth."""

from __future__ import annotations

import numpy as np

from ahnn.tracking.accelerations.atmospheres import Atmosphere, exponential
from ahnn.tracking.accelerations.contract import Acceleration, Array, inner, outer

ROTATION = 7.292115e-5
"""Rotation rate of the Earth, rad/s (IERS Conventions 2010, table 1.2)."""


class AtmosphericDrag:
    """Drag acceleration, with one parameter: the drag coefficient (dimensionless).

    Args:
        area_to_mass: m^2/kg.
        air: density of the air.
    """

    parameters: tuple[str, ...] = ("drag",)

    def __init__(self, area_to_mass: float, air: Atmosphere = exponential) -> None:
        self.strength, self.air = 0.5e3 * area_to_mass, air  # km

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration at a state. See `AccelerationTerm`."""
        density, gradient = self.air(t, r)
        spin = ROTATION * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        wind = v + r @ spin.T
        speed, dense = np.sqrt(inner(wind, wind)), -self.strength * density
        unit, strength = dense * speed * wind, p[..., :1]
        by_wind = dense[..., None] * (speed[..., None] * np.eye(3) + outer(wind / speed, wind))
        by_position = by_wind @ spin + outer(-self.strength * speed * wind, gradient)
        slopes = strength[..., None] * by_position, strength[..., None] * by_wind
        return Acceleration(strength * unit, *slopes, unit[..., None])
