"""Transformation of positions and velocities near the Earth between frames (IERS conventions).

TEME is rotated to the terrestrial frame by the sidereal time of 1982, as SGP4 defines it (Vallado et al.,
AIAA 2006-6753), and from there into GCRF by IAU 2006/2000A (IERS Conventions 2010), as is CIRS, the true
equator of date. Polar motion and UT1 - UTC are neglected: the rotations from TEME and CIRS do not involve
them; docs/frames.md lists the errors for ITRF.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.frame_names import CENTRES, FIXED_AT, INERTIAL, NAMES, SIDECAR, known
from ahnn.data.files.samples import Array, Track
from ahnn.data.files.table import Place
from ahnn.data.files.units import LENGTH, unit
from ahnn.optional_libraries import library

TURN = 7.292115146706979e-5
"""Rate of the Earth's rotation angle in rad/s (IERS Conventions 2010, 5.15)."""
TO_TT = {"UTC": 42.184, "TAI": 32.184, "GPS": 51.184, "TT": 0.0, "TDB": 0.0}
"""Offsets in seconds from a time scale to terrestrial time; for UTC including all leap seconds."""
CLOCKS = (*TO_TT, "TCB", "TCG", "UT1", "GMST", "MET", "MRT", "SCLK")
"""Time systems of CCSDS orbit data messages (502.0-B, 3.2.3.2)."""
JULIAN = 2451544.5
"""Julian date of the first day of 2000."""


def turned(content: Content, frame: str, file: str) -> Content:
    """Transform content to another frame.

    Args:
        content: three positions, with or without velocities.
        frame: one of `NAMES`.
        file: file name, for messages.

    Raises:
        UserError: an unspecified or unknown frame, times without epoch, or positions that are not three
            lengths.
    """
    given, place = known(content.frame), Place(file)
    if given == frame:
        return content
    if not given:
        expected = f"a frame that can be converted to {frame}: one of {', '.join((*NAMES, 'ITRF'))}"
        place.refuse(expected, content.frame or "none", "" if content.frame else SIDECAR)
    centre = [word for word in content.frame.upper().split(", ")[1:2] if word in CENTRES]
    if given not in INERTIAL and centre not in ([], ["EARTH"]):
        place.refuse(f"the Earth as the centre of {given}", centre[0])
    if content.momenta or len(content.positions) != 3 or unit(content.units.position).dimension != LENGTH:
        place.refuse(
            "three coordinates in a unit of length, with or without velocities",
            ", ".join((*content.positions, *content.rates)),
        )
    if content.epoch is None:
        place._replace(column=content.time).refuse("epochs such as 2024-03-01T12:00:00", "numbers")
    if content.clock not in TO_TT:
        place.refuse(f"epochs in one of the time scales {', '.join(TO_TT)}", content.clock)
    rest = content.frame.partition(",")
    tracks = tuple(of_track(track, content, given, frame) for track in content.tracks)
    return content._replace(frame=f"{frame}{rest[1]}{rest[2]}", tracks=tracks)


def of_track(track: Track, content: Content, given: str, frame: str) -> Track:
    """Transform a track to another frame."""
    assert content.epoch is not None
    second = unit(content.units.time).size
    moments, rows = np.unique(second * track.times, return_inverse=True)
    matrices = rotations(terrestrial(content.epoch, moments, content.clock), given, frame)[rows]
    positions, velocities = track.values[:, :3], track.values[:, 3:]
    if given == "ITRF" and velocities.shape[1]:
        velocities = velocities + np.cross([0.0, 0.0, TURN * second], positions)
    parts = [np.einsum("tij,tj->ti", matrices, part) for part in (positions, velocities) if part.shape[1]]
    return track._replace(values=np.concatenate(parts, axis=1))


def terrestrial(epoch: int, times: Array, clock: str) -> Array:
    """Return the Julian dates of terrestrial time, as (2, T) summands, for seconds after an epoch."""
    seconds, fraction = divmod(epoch, epochs.SECOND)
    days, of_day = divmod(seconds, epochs.DAY)
    parts = (of_day + fraction / epochs.SECOND + TO_TT[clock] + times) / epochs.DAY
    return np.stack((np.full_like(parts, JULIAN + days), parts))


def rotations(tt: Array, given: str, frame: str) -> NDArray[np.float64]:
    """Return matrices, (T, 3, 3), from a frame into another at Julian dates of TT, (2, T)."""
    return into_gcrf(tt, frame).transpose(0, 2, 1) @ into_gcrf(tt, given)


def into_gcrf(tt: Array, frame: str) -> NDArray[np.float64]:
    """Return matrices, (T, 3, 3), from a frame into GCRF at Julian dates of TT, (2, T)."""
    erfa = library("erfa", "pyerfa", "orbit", "system.frame")
    name, of, moment = frame.partition(FIXED_AT)
    matrices: Any = np.eye(3)
    if of:
        matrices = into_gcrf(terrestrial(epochs.instant(moment, utc=True), np.zeros(1), "UTC"), name)
    elif frame == "EME2000":
        matrices = erfa.bp00(*tt[:, 0])[0].T  # the mean equator and equinox of J2000.0
    elif frame == "CIRS":
        matrices = erfa.c2i06a(*tt).transpose(0, 2, 1)
    elif frame != "GCRF":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", erfa.ErfaWarning)  # for years without announced leap seconds
            ut1 = erfa.taiutc(*erfa.tttai(*tt))
        matrices = erfa.c2t06a(*tt, *ut1, 0.0, 0.0).transpose(0, 2, 1)
        if frame == "TEME":
            matrices = matrices @ erfa.rz(erfa.gmst82(*ut1), np.eye(3))
    return np.broadcast_to(matrices, (tt.shape[1], 3, 3))
