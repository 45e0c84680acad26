"""Geocentric positions of Sun and Moon from DE421 (Folkner et al., JPL 2009)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ahnn.data.files.frames import terrestrial
from ahnn.optional_libraries import library

SUN_MU, MOON_MU = 132712440040.944, 4902.800076
"""Gravitational parameters in km^3/s^2 (DE421)."""
MOON_FRACTION = 1 / (1 + 81.3005690699153)
"""Mass of the Moon as a fraction of the mass of Earth and Moon (DE421)."""
NODES, MARGIN = 3600.0, 4 * 3600.0
"""Seconds between the nodes of a position spline, and margin of the nodes."""


class SunAndMoon(NamedTuple):
    """Positions in km in the axes of GCRF.

    Attributes:
        sun: times (T,) or a time, seconds after the epoch -> (T, 3) or (3,).
        moon: as for the Sun.
    """

    sun: CubicSpline
    moon: CubicSpline


def sun_and_moon(epoch: int, first: float, last: float) -> SunAndMoon:
    """Return the positions of Sun and Moon between two times; TT is used as TDB (to 2 ms).

    Args:
        epoch: epoch of time zero, picoseconds of UTC as in `TrackingData`.
        first: beginning of the span, seconds after the epoch.
        last: end of the span, seconds after the epoch.

    Raises:
        UserError: jplephem or de421 is missing.
    """
    data = library("de421", "de421", "ephemeris", "Sun and Moon")
    ephemeris = library("jplephem.ephem", "jplephem", "ephemeris", "Sun and Moon").Ephemeris(data)
    times = np.arange(first - MARGIN, last + MARGIN + NODES, NODES)
    days, fraction = terrestrial(epoch, times, "UTC")
    moon = ephemeris.position("moon", days, fraction)
    earth = ephemeris.position("earthmoon", days, fraction) - MOON_FRACTION * moon
    sun = ephemeris.position("sun", days, fraction) - earth
    return SunAndMoon(CubicSpline(times, sun.T), CubicSpline(times, moon.T))
