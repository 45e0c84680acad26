"""Orientation of the Earth at time zero, for ground stations that rotate at a constant rate."""

from __future__ import annotations

import logging

import numpy as np

from ahnn.data.files.epochs import DAY, SECOND, leaps
from ahnn.data.files.frame_names import known
from ahnn.data.files.frames import JULIAN, rotations, terrestrial
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.optional_libraries import library
from ahnn.tracking.earth_rotation import MJD_2000
from ahnn.tracking.formats.finals import installed_orientation

log = logging.getLogger("ahnn")


def earth_axes(reference: Reference) -> float | list[list[float]]:
    """Return the argument `earth_angle` of `GroundStation` at the epoch of time zero; 0 without an epoch.

    For EME2000, GCRF and TEME it is the (3, 3) matrix from the frame to the Earth's axes by IAU 2006/2000A
    (IERS Conventions 2010, 5.4), with UT1 from the package astropy-iers-data if it covers the day, else
    UT1 = UTC. Polar motion (2e-6 rad) is neglected. The celestial pole is kept at its position at time zero,
    from which it moves by at most 1e-6 rad in a day and 1e-4 rad in a year. For other frames it is the
    Earth's rotation angle about the z axis, which is exact in CIRS, the true equator of date.

    Raises:
        UserError: pyerfa is missing.
    """
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
    erfa = library("erfa", "pyerfa", "orbit", "the Earth's rotation")
    moment = reference.on("UTC").epoch or 0
    tt = terrestrial(moment, np.zeros(1), "UTC")
    angle = erfa.era00(JULIAN, ut1_of(moment) / DAY)
    celestial = erfa.c2i06a(*tt[:, 0]) @ rotations(tt, frame, "GCRF")[0]
    return (erfa.rz(angle, np.eye(3)) @ celestial).tolist()


def ut1_of(moment: int) -> float:
    """Return UT1 in seconds since 2000-01-01 at a UTC epoch in picoseconds."""
    seconds = moment / SECOND
    as_utc = -leaps(int(seconds // DAY))
    try:
        rows = installed_orientation()
    except UserError:
        return seconds + as_utc
    days = rows.mjd - MJD_2000
    offsets = rows.ut1_utc - np.array([leaps(round(day)) for day in days])  # without the jumps of UTC
    return seconds + float(np.interp(seconds / DAY, days, offsets, left=as_utc, right=as_utc))
