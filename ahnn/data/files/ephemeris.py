"""Orbits as CCSDS ephemeris messages hold them: blocks of text, and what their numbers are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Array, Track, ordered
from ahnn.data.files.table import Fault, Note, Place, number, refuse
from ahnn.types import Units

COMPONENTS = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
REQUIRED = ("OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM")


class Covariance(NamedTuple):
    """Covariance of a state.

    Attributes:
        time: in seconds from the start of the ephemeris.
        matrix: (6, 6), in km and km/s.
        frame: of its components, "" for that of the ephemeris.
    """

    time: float
    matrix: Array
    frame: str = ""


class Ephemeris(NamedTuple):
    """One segment of an orbit ephemeris message.

    Attributes:
        object_id, object_name: of the satellite, such as 2009-012A.
        center, frame, time_system: such as EARTH, EME2000 and UTC.
        start: epoch in picoseconds (`epochs.instant`).
        times: (T,) seconds from the start.
        states: (T, 6) positions in km and velocities in km/s.
        covariances: of some of the states.
        rows: (T,) numbers of the lines that they are from.
    """

    object_id: str
    object_name: str
    center: str
    frame: str
    time_system: str
    start: int
    times: Array
    states: Array
    covariances: tuple[Covariance, ...] = ()
    rows: NDArray[np.int64] = np.zeros(0, dtype=np.int64)

    def epoch(self, time: float) -> str:
        """Return the epoch so many seconds after the start."""
        moment = self.start + round(time * epochs.SECOND)
        return epochs.spelled(moment, utc=self.time_system.upper() == "UTC")

    def metadata(self) -> dict[str, str]:
        """Return what a message says of a segment."""
        return {
            "OBJECT_NAME": self.object_name or self.object_id,
            "OBJECT_ID": self.object_id,
            "CENTER_NAME": self.center,
            "REF_FRAME": self.frame,
            "TIME_SYSTEM": self.time_system,
            "START_TIME": self.epoch(float(self.times[0])),
            "STOP_TIME": self.epoch(float(self.times[-1])),
        }


@dataclass
class Block:
    """A segment as text.

    Attributes:
        place: where it begins.
        meta: what is said of it.
        vectors: each with its line: an epoch and at least six numbers.
        matrices: each with its line: epoch, frame and the 21 numbers of a lower triangle.
    """

    place: Place
    meta: dict[str, str] = field(default_factory=dict)
    vectors: list[tuple[int, list[str]]] = field(default_factory=list)
    matrices: list[tuple[int, str, str, list[str]]] = field(default_factory=list)


def ephemeris(block: Block, note: Note = refuse) -> Ephemeris:
    """Return the numbers of a block.

    Args:
        block: a segment as text.
        note: of a state that is no epoch and numbers, which is then left out.

    Raises:
        UserError: names the line of what is missing, or what `note` raises.
    """
    for key in REQUIRED:
        if not block.meta.get(key):
            block.place._replace(column=key).refuse("a value in the metadata of a segment", "none")
    file, utc = block.place.file, block.meta["TIME_SYSTEM"].upper() == "UTC"
    rows, moments, states = [], [], []
    for row, cells in block.vectors:
        try:
            epoch = moment(cells[0], Place(file, row, "EPOCH"), utc=utc)
            states.append(values(cells[1:7], COMPONENTS, Place(file, row)))
        except Fault as fault:
            note(fault)
        else:
            rows.append(row)
            moments.append(epoch)
    if not rows:
        block.place.refuse("a state in each segment", "none")
    return Ephemeris(
        object_id=block.meta["OBJECT_ID"],
        object_name=block.meta.get("OBJECT_NAME", ""),
        center=block.meta["CENTER_NAME"],
        frame=block.meta["REF_FRAME"],
        time_system=block.meta["TIME_SYSTEM"],
        start=moments[0],
        times=np.array([(m - moments[0]) / epochs.SECOND for m in moments]),
        states=np.array(states),
        covariances=tuple(covariance(block, k, moments[0], utc=utc) for k in range(len(block.matrices))),
        rows=np.array(rows, dtype=np.int64),
    )


def covariance(block: Block, k: int, start: int, *, utc: bool) -> Covariance:
    """Return the k-th covariance of a block; raises UserError for less than a lower triangle."""
    row, epoch, frame, cells = block.matrices[k]
    place = Place(block.place.file, row, "EPOCH")
    if len(cells) != 21:
        place.refuse("the 21 numbers of a lower triangle of a covariance", f"{len(cells)}")
    matrix = np.zeros((6, 6))
    matrix[np.tril_indices(6)] = values(cells, ("covariance",) * 21, place)
    full = matrix + np.tril(matrix, -1).T
    return Covariance((moment(epoch, place, utc=utc) - start) / epochs.SECOND, full, frame)


def moment(text: str, place: Place, *, utc: bool) -> int:
    """Return an epoch in picoseconds; raises UserError."""
    try:
        return epochs.instant(text, utc=utc)
    except ValueError as error:
        place.refuse(str(error), repr(text))


def values(cells: list[str], names: tuple[str, ...], place: Place) -> list[float]:
    """Return the numbers in cells; raises UserError for what is none."""
    found = [number(cell, place._replace(column=name)) for cell, name in zip(cells, names, strict=True)]
    for name, value in zip(names, found, strict=True):
        if math.isnan(value):
            place._replace(column=name).refuse("a number", "none")
    return found


def content(blocks: list[Block], *, weighed: bool, note: Note = refuse) -> Content:
    """Return segments as trajectories, their times from the first epoch.

    Args:
        blocks: the segments.
        weighed: whether a mass is stated.
        note: of each state that is none, and each time that does not increase.

    Raises:
        UserError: segments that differ in centre, frame or time system, or what `note` raises.
    """
    found = [ephemeris(block, note) for block in blocks]
    for name in ("frame", "center", "time_system"):
        first = getattr(found[0], name)
        for block, other in zip(blocks, found, strict=True):
            if (received := getattr(other, name)) != first:
                block.place.refuse(f"{name} {first} in each segment", received, "Convert one of them")
    epoch = min(one.start for one in found)
    tracks = [
        Track(
            one.object_id,
            block.place.file,
            one.rows,
            one.times + (one.start - epoch) / epochs.SECOND,
            one.states,
        )
        for block, one in zip(blocks, found, strict=True)
    ]
    tracks = [ordered(track, "EPOCH", note) for track in tracks]
    frame = f"{found[0].frame}, {found[0].center}, {found[0].time_system}"
    return of_orbits(tracks, frame, epoch, weighed=weighed)


def of_orbits(tracks: list[Track], frame: str, epoch: int, *, weighed: bool) -> Content:
    """Return orbits in km and km/s, their times in seconds from an epoch of the clock that ends `frame`."""
    units = Units("s", "km", "km/s", f"{'kg ' if weighed else ''}km²/s²")
    names, rates, clock = ("x", "y", "z"), ("vx", "vy", "vz"), frame.rpartition(" ")[2].upper()
    return Content(names, rates, False, units, frame, tuple(tracks), epoch, clock)
