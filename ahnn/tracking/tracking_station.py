"""Tracking stations: coordinates, local axes, and displacement by solid Earth tides."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.formats.station_catalogue import geodetic, local_axes

Array = NDArray[np.float64]
RADIUS, FLATTENING = 6378.137, 1 / 298.257223563
"""WGS 84 ellipsoid, km."""
EARTH_MU = 398600.4415
LOVE, LOVE_LATITUDE, SHIDA, SHIDA_LATITUDE = 0.6078, -0.0006, 0.0847, 0.0002
"""Love and Shida numbers h2 and l2 with their latitude dependence (IERS Conventions 2010, 7.1.1)."""
LOVE_3, SHIDA_3 = 0.292, 0.015
"""Love and Shida numbers h3 and l3."""


class TrackingStation(NamedTuple):
    """Station in ITRF.

    Attributes:
        name: name used in the measurements.
        position: (3,) geocentric position of the reference point, km.
        latitude, longitude: geodetic, rad.
        height: above the ellipsoid, km.
    """

    name: str
    position: Array
    latitude: float
    longitude: float
    height: float

    @property
    def axes(self) -> Array:
        """Unit vectors east, north and up as rows, (3, 3)."""
        return local_axes(self.position)[[2, 1, 0]]


def geodetic_station(name: str, latitude: float, longitude: float, height: float) -> TrackingStation:
    """Build a station from geodetic coordinates, degrees and km."""
    lat, lon = np.radians((latitude, longitude))
    squared = FLATTENING * (2 - FLATTENING)
    normal = RADIUS / np.sqrt(1 - squared * np.sin(lat) ** 2)
    level = (normal + height) * np.cos(lat)
    up = (normal * (1 - squared) + height) * np.sin(lat)
    return TrackingStation(
        name, np.array([level * np.cos(lon), level * np.sin(lon), up]), float(lat), float(lon), height
    )


def cartesian_station(name: str, position: Array) -> TrackingStation:
    """Build a station from a point in ITRF, (3,) km."""
    return TrackingStation(name, position, *geodetic(position))


def tidal_displacement(position: Array, body: Array, mu: float) -> Array:
    """Return the tidal displacement of a station caused by a body, (T, 3) km in ITRF.

    Degrees 2 and 3, in phase (IERS Conventions 2010, 7.5 and 7.6); neglected terms, mainly the K1 resonance,
    are at most 13 mm. The permanent part is included: coordinates are tide-free.

    Args:
        position: station position, (3,) km in ITRF.
        body: position of Sun or Moon, (T, 3) km in ITRF.
        mu: gravitational parameter of the body, km^3/s^2.
    """
    away = np.linalg.norm(body, axis=-1, keepdims=True)
    e, distance = body / away, np.linalg.norm(position)
    up = position / distance
    cosine = (e @ up)[:, None]
    strength = mu / EARTH_MU * RADIUS**4 / away**3
    latitude = (3 * up[2] ** 2 - 1) / 2
    h, shida = LOVE + LOVE_LATITUDE * latitude, SHIDA + SHIDA_LATITUDE * latitude
    level = e - cosine * up
    second = h * up * (1.5 * cosine**2 - 0.5) + 3 * shida * cosine * level
    third = LOVE_3 * up * (2.5 * cosine**3 - 1.5 * cosine) + SHIDA_3 * (7.5 * cosine**2 - 1.5) * level
    return strength * (second + RADIUS / away * third)
