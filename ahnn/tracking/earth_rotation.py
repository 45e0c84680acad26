"""Earth rotation: matrices from GCRF to ITRF by IAU 2006/2000A, with measured UT1 and polar motion.

IERS Conventions (2010), chapter 5, based on the celestial intermediate origin, with the routines of ERFA.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ahnn.data.files import epochs
from ahnn.data.files.frames import terrestrial
from ahnn.errors import UserError
from ahnn.optional_libraries import library
from ahnn.tracking.formats.bulletin_b import EarthOrientation

Array = NDArray[np.float64]
MJD_2000 = 51544
"""Modified Julian date of 2000-01-01."""
TT_TO_TAI = -32.184
ARCSECOND = np.pi / 648000
NODES = 3600.0
"""Seconds between nodes of precession and nutation, whose shortest terms have periods of days."""
MARGIN = 4 * NODES
"""Margin of the nodes beyond the time span, in seconds."""


class EarthRotation:
    """Matrices from GCRF to ITRF at times.

    Args:
        epoch: epoch of time zero, picoseconds of UTC as in `TrackingData`.
        first, last: time span of the matrices, seconds after the epoch.
        rows: measured orientation, at least four days that enclose this span. Subdaily tides in UT1 and pole
            (a few cm on the ground) are neglected.

    Raises:
        UserError: the rows do not cover the span, or pyerfa is missing.
    """

    def __init__(self, epoch: int, first: float, last: float, rows: EarthOrientation) -> None:
        self.epoch, self.first, self.last, self.rows = epoch, first, last, rows
        self._erfa = library("erfa", "pyerfa", "orbit", "the Earth's rotation")
        since = self._since
        if len(rows.mjd) < 4 or since[0] > first or since[-1] < last:
            asked, known = (self.day(first), self.day(last)), (rows.mjd[0], rows.mjd[-1])
            message = (
                f"orientation: expected four days that enclose MJD {asked[0]:.1f} to {asked[1]:.1f}; "
                f"received {len(rows.mjd)} days, {known[0]:.0f} to {known[1]:.0f}. Give bulletins for that "
                "time"
            )
            raise UserError(message)

    def day(self, time: float) -> float:
        """Return the modified Julian date of a time, to within half a minute."""
        return MJD_2000 + (self.epoch / epochs.SECOND + time) / epochs.DAY

    @cached_property
    def _since(self) -> Array:
        """Times of the rows (at midnight) in seconds after the epoch, including leap seconds."""
        days = np.round(self.rows.mjd).astype(int) - MJD_2000
        seconds = np.array([int(d) * epochs.DAY + epochs.leaps(int(d)) for d in days])
        return seconds - self.epoch / epochs.SECOND

    @cached_property
    def _measured(self) -> CubicSpline:
        """TAI - 10 s - UT1 in s, pole coordinates x, y and offsets dX, dY in rad: (T,) -> (T, 5)."""
        rows = self.rows
        leaps = np.array([epochs.leaps(round(d) - MJD_2000) for d in rows.mjd])
        angles = ARCSECOND * np.column_stack((rows.x, rows.y, rows.pole))
        return CubicSpline(self._since, np.column_stack((leaps - rows.ut1_utc, angles)), axis=0)

    @cached_property
    def _intermediate(self) -> CubicSpline:
        """Matrices from GCRF to the celestial intermediate frame, (T,) -> (T, 3, 3)."""
        nodes = np.arange(self.first - MARGIN, self.last + MARGIN + NODES, NODES)
        x, y, s = self._erfa.xys06a(*terrestrial(self.epoch, nodes, "UTC"))
        measured = self._measured(nodes)
        return CubicSpline(nodes, self._erfa.c2ixys(x + measured[:, 3], y + measured[:, 4], s), axis=0)

    def matrices(self, times: Array) -> Array:
        """Return the matrices from GCRF to ITRF at times (T,), shape (T, 3, 3)."""
        measured = self._measured(times)
        tt, fraction = terrestrial(self.epoch, times, "UTC")
        # Instants are in TAI - 10 s, like all epochs: leap seconds since 1972 are elapsed time.
        ut1 = fraction + (TT_TO_TAI - 10 - measured[:, 0]) / epochs.DAY
        angle = self._erfa.era00(tt, ut1)
        polar = self._erfa.pom00(measured[:, 1], measured[:, 2], self._erfa.sp00(tt, fraction))
        turn = np.zeros((len(times), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 0, 1] = np.sin(angle)
        turn[:, 1, 0], turn[:, 2, 2] = -turn[:, 0, 1], 1.0
        return polar @ turn @ self._intermediate(times)
