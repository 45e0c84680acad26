"""Solar radiation pressure on a sphere, with umbra and penumbra."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ahnn.tracking.accelerations.contract import NONE, Acceleration, Array, inner, outer

PRESSURE = 1361.0 / 299792458.0
"""Radiation pressure in N/m^2 at 1 au: total solar irradiance (Kopp & Lean 2011) over the speed of light."""
UNIT = 149597870.7
"""Astronomical unit, km."""
SUN_RADIUS, EARTH_RADIUS = 695700.0, 6378.137
"""Radii of Sun and Earth, km (IAU 2015 resolution B3, WGS 84)."""


class RadiationPressure:
    """Acceleration away from the Sun, with one parameter: the reflection coefficient (dimensionless).

    Args:
        area_to_mass: m^2/kg.
        sun: t -> (3,) geocentric position, km.
    """

    parameters: tuple[str, ...] = ("reflection",)

    def __init__(self, area_to_mass: float, sun: Callable[[float], Array]) -> None:
        self.strength, self.sun = PRESSURE * area_to_mass * UNIT**2 / 1e3, sun

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the acceleration at a state; derivatives neglect the gradient of the shadow."""
        sun = self.sun(t)
        line = r - sun
        distance = np.sqrt(inner(line, line))
        lit = self.strength * lit_fraction(r, sun)[..., None] / distance**3
        unit, strength = lit * line, p[..., :1]
        tensor = lit[..., None] * (np.eye(3) - 3 * outer(line / distance**2, line))
        return Acceleration(strength * unit, strength[..., None] * tensor, NONE, unit[..., None])


def lit_fraction(r: Array, sun: Array) -> Array:
    """Return the fraction of the Sun's disk not hidden by the Earth, (...) (Montenbruck & Gill, 3.4.2).

    Args:
        r: satellite, (..., 3) km from the Earth's centre.
        sun: (3,), likewise.
    """
    line = sun - r
    away, distance = np.sqrt(inner(line, line))[..., 0], np.sqrt(inner(r, r))[..., 0]
    a, b = np.arcsin(SUN_RADIUS / away), np.arcsin(np.minimum(1.0, EARTH_RADIUS / distance))
    apart = np.arccos(np.clip(-inner(r, line)[..., 0] / (distance * away), -1.0, 1.0))
    if bool(np.all(apart >= a + b)):
        return np.ones_like(apart)
    # The two points coincide for disks that do not intersect.
    x = (apart**2 + a**2 - b**2) / (2 * np.maximum(apart, 1e-12))
    hidden = a**2 * np.arccos(np.clip(x / a, -1, 1)) + b**2 * np.arccos(np.clip((apart - x) / b, -1, 1))
    hidden = hidden - apart * np.sqrt(np.maximum(0.0, a**2 - x**2))
    within = np.where(b >= a, 0.0, 1 - (b / a) ** 2)
    part = np.where(apart <= np.abs(b - a), within, 1 - hidden / (np.pi * a**2))
    return np.where(apart >= a + b, 1.0, part)
