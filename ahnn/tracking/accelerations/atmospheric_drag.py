"""Drag of an exponential atmosphere that rotates with the Earth."""

from __future__ import annotations

import numpy as np

from ahnn.tracking.accelerations.contract import Acceleration, Array, inner, outer

ROTATION = 7.292115e-5
"""Rotation rate of the Earth, rad/s (IERS Conventions 2010, table 1.2)."""
RADIUS = 6378.137
"""Radius of the Earth, km."""
LAYERS = np.array(
    [
        (150.0, 2.070e-9, 22.523),
        (180.0, 5.464e-10, 29.740),
        (200.0, 2.789e-10, 37.105),
        (250.0, 7.248e-11, 45.546),
        (300.0, 2.418e-11, 53.628),
        (350.0, 9.518e-12, 53.298),
        (400.0, 3.725e-12, 58.515),
        (450.0, 1.585e-12, 60.828),
        (500.0, 6.967e-13, 63.822),
        (600.0, 1.454e-13, 71.835),
        (700.0, 3.614e-14, 88.667),
        (800.0, 1.170e-14, 124.64),
        (900.0, 5.245e-15, 181.05),
        (1000.0, 3.019e-15, 268.00),
    ]
)
"""Base height in km, density there in kg/m^3, scale height in km (Vallado 2013, table 8-4)."""


class AtmosphericDrag:
    """Drag acceleration, with one parameter: the drag coefficient (dimensionless).

    Args:
        area_to_mass: m^2/kg.
    """

    parameters: tuple[str, ...] = ("drag",)

    def __init__(self, area_to_mass: float) -> None:
        self.strength = 0.5e3 * area_to_mass  # km

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration at a state; heights are above a sphere. See `AccelerationTerm`."""
        del t
        distance = np.sqrt(inner(r, r))
        density, scale = atmosphere(distance - RADIUS)
        spin = ROTATION * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        wind = v + r @ spin.T
        speed, dense = np.sqrt(inner(wind, wind)), -self.strength * density
        unit, strength = dense * speed * wind, p[..., :1]
        by_wind = dense[..., None] * (speed[..., None] * np.eye(3) + outer(wind / speed, wind))
        by_position = by_wind @ spin - outer(unit / (distance * scale), r)
        slopes = strength[..., None] * by_position, strength[..., None] * by_wind
        return Acceleration(strength * unit, *slopes, unit[..., None])


def atmosphere(height: Array) -> tuple[Array, Array]:
    """Return densities in kg/m^3 and scale heights in km at heights in km; the lowest is extrapolated."""
    layer = np.maximum(0, np.searchsorted(LAYERS[:, 0], height, side="right") - 1)
    base, density, scale = np.moveaxis(LAYERS[layer], -1, 0)
    return density * np.exp((base - height) / scale), scale
