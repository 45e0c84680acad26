"""Solar radiation pressure on a sphere, with umbra and penumbra."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ahnn.tracking.accelerations.contract import NONE, Acceleration, Array

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
        del v
        sun = self.sun(t)
        line = r - sun
        distance = np.linalg.norm(line)
        lit = self.strength * lit_fraction(r, sun)
        unit = lit * line / distance**3
        tensor = lit * (np.eye(3) / distance**3 - 3 * np.outer(line, line) / distance**5)
        return Acceleration(p[0] * unit, p[0] * tensor, NONE, unit[:, None])


def lit_fraction(r: Array, sun: Array) -> float:
    """Return the fraction of the Sun's disk not hidden by the Earth (Montenbruck & Gill, 3.4.2).

    Args:
        r: satellite, (3,) geocentric position, km.
        sun: Sun, (3,) geocentric position, km.
    """
    line = sun - r
    away, distance = float(np.linalg.norm(line)), float(np.linalg.norm(r))
    a, b = np.arcsin(SUN_RADIUS / away), np.arcsin(min(1.0, EARTH_RADIUS / distance))
    apart = np.arccos(np.clip(-(r @ line) / (distance * away), -1.0, 1.0))
    if apart >= a + b:
        return 1.0
    if apart <= b - a:
        return 0.0
    if apart <= a - b:
        return float(1 - (b / a) ** 2)
    x = (apart**2 + a**2 - b**2) / (2 * apart)
    hidden = a**2 * np.arccos(np.clip(x / a, -1, 1)) + b**2 * np.arccos(np.clip((apart - x) / b, -1, 1))
    hidden -= apart * np.sqrt(max(0.0, a**2 - x**2))
    return float(1 - hidden / (np.pi * a**2))
