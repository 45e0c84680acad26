"""Station catalogue: measurement reference points as functions of time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.arguments import nearest
from ahnn.data.files import epochs
from ahnn.errors import UserError

YEAR = 365.25 * epochs.DAY
"""Seconds per year for velocities."""
RADIUS, FLATTENING = 6378.137, 1 / 298.257222101
"""GRS80 ellipsoid, in km, whose normals define the vertical (Moritz, Geodetic Reference System 1980)."""

Vector = NDArray[np.float64]


class StationSolution(NamedTuple):
    """Position and velocity of a marker.

    Attributes:
        reference: moment of the position (`epochs.instant`).
        position: (3,) km in the terrestrial frame.
        velocity: (3,) km per year; 0 if unknown.
        start, end: time span of the data; None if unspecified.
    """

    reference: int
    position: Vector
    velocity: Vector
    start: int | None
    end: int | None

    def at(self, moment: int) -> Vector:
        """Return the position at a moment, in km."""
        return self.position + self.velocity * ((moment - self.reference) / epochs.SECOND / YEAR)


class Eccentricity(NamedTuple):
    """Vector from the marker to the reference point of measurements.

    Attributes:
        start, end: time span of validity; None for open ends.
        offset: up, north and east if local, otherwise x, y and z, in km.
        local: whether the offset is local.
    """

    start: int | None
    end: int | None
    offset: tuple[float, float, float]
    local: bool


@dataclass
class StationCatalogue:
    """Stations by their codes, such as 7090.

    Attributes:
        solutions: solutions of each code, in order of time.
        eccentricities: eccentricities of each code.
        unused: unused blocks and parameters of the files.
    """

    solutions: dict[str, list[StationSolution]] = field(default_factory=dict)
    eccentricities: dict[str, list[Eccentricity]] = field(default_factory=dict)
    unused: dict[str, None] = field(default_factory=dict)

    def position(self, code: str, moment: int) -> Vector:
        """Return the reference point of a station in the terrestrial frame, (3,) km.

        If no solution covers the moment, the last one that began before it is extrapolated. Without any
        eccentricities, the marker itself is the reference point.

        Args:
            code: station code.
            moment: picoseconds since 2000-01-01 in UTC with all leap seconds (`epochs.instant`).

        Raises:
            UserError: no solution for the station, or no eccentricity at that time.
        """
        when = epochs.spelled(moment, utc=True)
        if code not in self.solutions:
            guess = nearest(code, tuple(self.solutions))
            among = f"its position among {len(self.solutions)} stations"
            message = f"station {code}: expected {among}; received none{guess}"
            raise UserError(message)
        began = [one for one in self.solutions[code] if one.start is None or one.start <= moment]
        if not began:
            first = epochs.spelled(self.solutions[code][0].start or 0, utc=True)
            message = (
                f"station {code}: expected a solution for {when}; received solutions starting at {first}"
            )
            raise UserError(message)
        marker = began[-1].at(moment)
        if not self.eccentricities:
            return marker
        for one in self.eccentricities.get(code, ()):
            if (one.start is None or one.start <= moment) and (
                one.end is None or moment <= one.end + epochs.SECOND
            ):
                offset = np.array(one.offset)
                return marker + (offset @ local_axes(marker) if one.local else offset)
        message = f"station {code}: expected an eccentricity for {when}; received none for that time"
        raise UserError(message)


def geodetic(position: Vector) -> tuple[float, float, float]:
    """Return latitude and longitude in rad, and height in km above GRS80, of a position in km.

    The latitude is found by fixed-point iteration of tan(latitude) = (z + e² N sin(latitude)) / p, which
    contracts by e² near the Earth's surface.
    """
    x, y, z = (float(one) for one in position)
    p, e2 = float(np.hypot(x, y)), FLATTENING * (2 - FLATTENING)
    latitude = float(np.arctan2(z, p * (1 - e2)))
    for _ in range(8):
        n = RADIUS / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
        latitude = float(np.arctan2(z + e2 * n * np.sin(latitude), p))
    n = RADIUS / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    height = p * np.cos(latitude) + z * np.sin(latitude) - n * (1 - e2 * np.sin(latitude) ** 2)
    return latitude, float(np.arctan2(y, x)), float(height)


def local_axes(position: Vector) -> Vector:
    """Return the unit vectors up, north and east at a position, the rows of a (3, 3) matrix."""
    latitude, longitude, _ = geodetic(position)
    (sf, cf), (sl, cl) = ((np.sin(a), np.cos(a)) for a in (latitude, longitude))
    return np.array([[cf * cl, cf * sl, sf], [-sf * cl, -sf * sl, cf], [-sl, cl, 0.0]])
