"""Orientation of the Earth in the days around time zero, for ground stations."""

from __future__ import annotations

import functools
import logging

import numpy as np
import torch
from numpy.typing import NDArray

from ahnn.data.files.epochs import DAY, SECOND, leaps
from ahnn.data.files.frame_names import known
from ahnn.data.files.frames import JULIAN, rotations, terrestrial
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.measurements import DailyAxes
from ahnn.measurements.ground_station import EARTH_RATE
from ahnn.optional_libraries import library
from ahnn.tracking.earth_rotation import ARCSECOND, MJD_2000
from ahnn.tracking.formats.finals import installed_orientation

log = logging.getLogger("ahnn")

Array = NDArray[np.float64]
SPAN = -1000, 3000
"""First and last day of the axes, in days after time zero; the celestial pole is fixed before and after."""


def earth_axes(reference: Reference | str) -> float | DailyAxes:
    """Return the argument `earth_angle` of `GroundStation` for an epoch of time zero; 0 without an epoch.

    For EME2000 and GCRF these are daily matrices from the frame to the Earth's axes by IAU 2006/2000B (within
    1e-8 rad of 2006/2000A; IERS Conventions 2010, 5.4), for TEME of date by the sidereal time of 1982. UT1
    and the pole come from the package astropy-iers-data; before its first day UT1 = UTC, after its last one
    UT1 keeps its offset from atomic time, and the pole is that of the nearest day. Linear interpolation adds
    up to 3e-8 rad. For other frames it is the Earth's rotation angle about the z axis, which in CIRS, the
    true equator of date, neglects UT1 and the pole.

    Args:
        reference: frame and epoch, or their text.

    Raises:
        UserError: pyerfa is missing.
    """
    reference = Reference.of(reference) if isinstance(reference, str) else reference
    if reference.epoch is None:
        return 0.0
    if (frame := known(reference.frame)) in ("", "ITRF", "CIRS"):
        if reference.frame != "CIRS":
            received = reference.frame or "none"
            message = (
                "stations: expected frame=EME2000, GCRF, TEME or CIRS; received %s, which is treated as CIRS"
            )
            log.warning(message, received)
        return reference.earth_angle()
    return daily_axes(frame, reference.on("UTC").epoch or 0)


@functools.cache
def daily_axes(frame: str, moment: int) -> DailyAxes:
    """Return the Earth's axes in an inertial frame around a UTC epoch in picoseconds; see `earth_axes`."""
    erfa = library("erfa", "pyerfa", "orbit", "the Earth's rotation")
    times = DAY * np.arange(SPAN[0], SPAN[1] + 1, dtype=float)
    tt = terrestrial(moment, times, "UTC")
    ut1 = ut1_of(moment, times) / DAY
    if frame == "TEME":
        angles, celestial = erfa.gmst82(JULIAN, ut1), np.eye(3)
    else:
        x, y = erfa.bpn2xy(erfa.pn06(*tt, *erfa.nut00b(*tt))[-1])
        celestial = erfa.c2ixys(x, y, erfa.s06(*tt, x, y)) @ rotations(tt[:, :1], frame, "GCRF")[0]
        angles = erfa.era00(JULIAN, ut1)
    matrices = erfa.rz(angles - EARTH_RATE * times, np.eye(3)) @ celestial
    return DailyAxes(torch.from_numpy(matrices), float(times[0]), float(DAY), pole_of(moment, times))


def ut1_of(moment: int, times: Array) -> Array:
    """Return UT1 in seconds since 2000-01-01 at times (T,), in seconds after a UTC epoch in picoseconds."""
    seconds = moment / SECOND + times
    try:
        rows = installed_orientation()
    except UserError:
        return seconds - leaps(int(moment / SECOND // DAY))
    days = rows.mjd - MJD_2000
    offsets = rows.ut1_utc - np.array([leaps(round(day)) for day in days])  # without the jumps of UTC
    before = np.array([-leaps(int(day)) for day in seconds[seconds < days[0] * DAY] // DAY], dtype=float)
    found = np.interp(seconds / DAY, days, offsets)
    found[: len(before)] = before
    return seconds + found


def pole_of(moment: int, times: Array) -> torch.Tensor | None:
    """Return the coordinates x and y of the pole in rad, (T, 2), likewise; None if they are not installed."""
    try:
        rows = installed_orientation()
    except UserError:
        return None
    days = (moment / SECOND + times) / DAY
    found = [np.interp(days, rows.mjd - MJD_2000, one) for one in (rows.x, rows.y)]
    return torch.from_numpy(ARCSECOND * np.column_stack(found))
