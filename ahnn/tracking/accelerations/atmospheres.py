"""Densities of the upper atmosphere: exponential layers, and Harris-Priester with the diurnal bulge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ahnn.tracking.accelerations.contract import Array, inner

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
HEIGHTS = np.array([100, *range(120, 300, 10), *range(300, 800, 20), *range(800, 1001, 40)], dtype=float)
"""Heights in km of the two tables below (Montenbruck & Gill 2000, Satellite Orbits, 3.5.2)."""
NIGHT = 1e-12 * np.array(
    [
        *(497400.0, 24900.0, 8377.0, 3899.0, 2122.0, 1263.0, 800.8, 528.3, 361.7, 255.7, 183.9, 134.1),
        *(99.49, 74.88, 57.09, 44.03, 34.30, 26.97, 21.39, 17.08, 10.99, 7.214, 4.824, 3.274, 2.249),
        *(1.558, 1.091, 0.7701, 0.5474, 0.3916, 0.2819, 0.2042, 0.1488, 0.1092, 0.08070, 0.06012, 0.04519),
        *(0.03430, 0.02632, 0.02043, 0.01607, 0.01281, 0.01036, 0.008496, 0.007069, 0.004680, 0.003200),
        *(0.002210, 0.001560, 0.001150),
    ]
)
"""Minimum densities, kg/m^3, at mean solar activity."""
DAY = 1e-12 * np.array(
    [
        *(497400.0, 24900.0, 8710.0, 4059.0, 2215.0, 1344.0, 875.8, 601.0, 429.7, 316.2, 239.6, 185.3),
        *(145.5, 115.7, 93.08, 75.55, 61.82, 50.95, 42.26, 35.26, 25.11, 18.19, 13.37, 9.955, 7.492),
        *(5.684, 4.355, 3.362, 2.612, 2.042, 1.605, 1.267, 1.005, 0.7997, 0.6390, 0.5123, 0.4121),
        *(0.3325, 0.2691, 0.2185, 0.1779, 0.1452, 0.1190, 0.09776, 0.08059, 0.05741, 0.04210),
        *(0.03130, 0.02360, 0.01810),
    ]
)
"""Maximum densities, likewise."""
LAG = np.radians(30.0)
"""Right ascension of the densest air relative to the Sun: about two hours after noon."""


class Atmosphere(Protocol):
    """Density of the air."""

    def __call__(self, t: float, r: Array) -> tuple[Array, Array]:
        """Return the density (..., 1) in kg/m^3 at r (..., 3) km and time t, and its gradient (..., 3)."""
        ...


def exponential(t: float, r: Array) -> tuple[Array, Array]:
    """Return density and gradient of exponential layers; heights are above a sphere. See `Atmosphere`."""
    del t
    distance = np.sqrt(inner(r, r))
    density, scale = atmosphere(distance - RADIUS)
    return density, -density / (distance * scale) * r


class HarrisPriester:
    """Density between night and day values, with a bulge that lags the Sun; heights are above a sphere.

    Args:
        sun: t -> (3,) geocentric position, in any unit.
        exponent: n in cos^n(psi/2), psi measured from the bulge: 2 for low inclinations, 6 for polar orbits.
    """

    def __init__(self, sun: Callable[[float], Array], exponent: float) -> None:
        self.sun, self.exponent = sun, exponent

    def __call__(self, t: float, r: Array) -> tuple[Array, Array]:
        """Return density and gradient, see `Atmosphere`."""
        x, y, z = self.sun(t)
        bulge = np.array([x * np.cos(LAG) - y * np.sin(LAG), x * np.sin(LAG) + y * np.cos(LAG), z])
        bulge = bulge / np.linalg.norm(bulge)
        distance = np.sqrt(inner(r, r))
        along = r / distance
        fraction = (1 + along @ bulge[:, None]) / 2  # cos^2(psi/2)
        by_fraction = self.exponent / 2 * fraction ** (self.exponent / 2 - 1)
        (night, slope), (day, steep) = (tabulated(distance - RADIUS, table) for table in (NIGHT, DAY))
        weight = fraction ** (self.exponent / 2)
        turn = by_fraction * (bulge - along * (along @ bulge[:, None])) / (2 * distance)
        gradient = (slope + (steep - slope) * weight) * along + (day - night) * turn
        return night + (day - night) * weight, gradient


def atmosphere(height: Array) -> tuple[Array, Array]:
    """Return densities in kg/m^3 and scale heights in km at heights in km; end layers are extrapolated."""
    layer = np.maximum(0, np.searchsorted(LAYERS[:, 0], height, side="right") - 1)
    base, density, scale = np.moveaxis(LAYERS[layer], -1, 0)
    return density * np.exp((base - height) / scale), scale


def tabulated(height: Array, densities: Array) -> tuple[Array, Array]:
    """Return densities at heights in km, and their derivatives; exponential between and beyond table rows."""
    k = np.clip(np.searchsorted(HEIGHTS, height, side="right") - 1, 0, len(HEIGHTS) - 2)
    rate = np.log(densities[k + 1] / densities[k]) / (HEIGHTS[k + 1] - HEIGHTS[k])
    found = densities[k] * np.exp(rate * (height - HEIGHTS[k]))
    return found, rate * found
