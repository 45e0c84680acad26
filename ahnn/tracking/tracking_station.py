"""Where a station stands, what its horizon is, and how the tides of the solid Earth move it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.formats.station_catalogue import geodetic, local_axes

Array = NDArray[np.float64]
RADIUS, FLATTENING = 6378.137, 1 / 298.257223563
"""Of the ellipsoid of WGS 84, km."""
EARTH_MU = 398600.4415
LOVE, LOVE_LATITUDE, SHIDA, SHIDA_LATITUDE = 0.6078, -0.0006, 0.0847, 0.0002
"""h2 and l2 with their change by latitude (IERS Conventions 2010, 7.1.1)."""
LOVE_3, SHIDA_3 = 0.292, 0.015
"""h3 and l3."""


class TrackingStation(NamedTuple):
    """A station in the axes of ITRF.

    Attributes:
        name: as the measurements name it.
        position: (3,) km from the Earth's centre, of the point that measures.
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
        """Unit vectors to the east, the north and up as rows, (3, 3)."""
        return local_axes(self.position)[[2, 1, 0]]


def geodetic_station(name: str, latitude: float, longitude: float, height: float) -> TrackingStation:
    """Return the station at geodetic coordinates, degrees and km."""
    lat, lon = np.radians((latitude, longitude))
    squared = FLATTENING * (2 - FLATTENING)
    normal = RADIUS / np.sqrt(1 - squared * np.sin(lat) ** 2)
    level = (normal + height) * np.cos(lat)
    up = (normal * (1 - squared) + height) * np.sin(lat)
    return TrackingStation(
        name, np.array([level * np.cos(lon), level * np.sin(lon), up]), float(lat), float(lon), height
    )


def cartesian_station(name: str, position: Array) -> TrackingStation:
    """Return the station at a point in ITRF, (3,) km."""
    return TrackingStation(name, position, *geodetic(position))


def tidal_displacement(position: Array, body: Array, mu: float) -> Array:
    """Return what the tide of a body displaces a station by, in km and ITRF, (T, 3).

    Degrees 2 and 3, in phase (IERS Conventions 2010, 7.5 and 7.6); what is left out, most of it the
    resonance of K1, is at most 13 mm. The constant part is within: coordinates are tide-free.

    Args:
        position: of the station, (3,) km in ITRF.
        body: Sun or Moon, (T, 3) km in ITRF.
        mu: its gravitational parameter, km^3/s^2.
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
