"""Content of CCSDS ephemeris messages: text blocks, and their conversion to numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.arguments import nearest
from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.frame_names import canonical
from ahnn.data.files.frames import CLOCKS
from ahnn.data.files.samples import Array, Track, ordered
from ahnn.data.files.table import Fault, Note, Place, Remark, number, refuse
from ahnn.types import Units

COMPONENTS = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
ACCELERATION = ("X_DDOT", "Y_DDOT", "Z_DDOT")
REQUIRED = ("OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM")
SPANS = ("START_TIME", "STOP_TIME"), ("USEABLE_START_TIME", "USEABLE_STOP_TIME")
USED = (*REQUIRED, "OBJECT_NAME", "REF_FRAME_EPOCH", *SPANS[0], *SPANS[1])
UNUSED = ("INTERPOLATION", "INTERPOLATION_DEGREE")
"""Optional metadata of a segment."""
HEADER = ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "CLASSIFICATION")
VERSIONS = ("1.0", "2.0", "3.0")


ALONE = "Give the ephemeris in a separate file"
FIXED = ("EME2000", "GCRF", "ICRF")
"""Frames without an epoch."""
COMMENTS = 3
"""Number of comments that are quoted."""
SLACK = epochs.SECOND // 1000
"""Tolerance for rounded ends of time spans."""


class Covariance(NamedTuple):
    """Covariance of a state.

    Attributes:
        time: seconds since the start of the ephemeris.
        matrix: (6, 6) covariance, in km and km/s.
        frame: frame of its components, such as RTN; "": the frame of the ephemeris.
    """

    time: float
    matrix: Array
    frame: str = ""


class Ephemeris(NamedTuple):
    """One segment of an orbit ephemeris message.

    Attributes:
        object_id, object_name: identifiers of the satellite, such as 2009-012A.
        center, frame, time_system: centre, frame and time scale, such as EARTH, EME2000 and UTC.
        start: epoch in picoseconds (`epochs.instant`).
        times: (T,) seconds since the start.
        states: (T, 6) positions in km and velocities in km/s.
        covariances: covariances of some of the states.
        rows: (T,) line numbers.
        frame_epoch: epoch of a frame of date; "" for all other frames.
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
    frame_epoch: str = ""

    def epoch(self, time: float) -> str:
        """Return the epoch at a number of seconds after the start."""
        moment = self.start + round(time * epochs.SECOND)
        return epochs.spelled(moment, utc=self.time_system.upper() == "UTC")

    def metadata(self) -> dict[str, str]:
        """Return the metadata of a segment."""
        return {
            "OBJECT_NAME": self.object_name or self.object_id,
            "OBJECT_ID": self.object_id,
            "CENTER_NAME": self.center,
            "REF_FRAME": self.frame,
            **({"REF_FRAME_EPOCH": self.frame_epoch} if self.frame_epoch else {}),
            "TIME_SYSTEM": self.time_system,
            "START_TIME": self.epoch(float(self.times[0])),
            "STOP_TIME": self.epoch(float(self.times[-1])),
        }


@dataclass
class MessageBlock:
    """A segment as text.

    Attributes:
        place: beginning of the segment.
        meta: metadata.
        vectors: states with line numbers: an epoch and at least six numbers.
        matrices: covariances with line numbers: epoch, frame and the 21 numbers of a lower triangle.
        unused: other content, which is not read.
        comments: comments; those of a message are kept in its first segment.
    """

    place: Place
    meta: dict[str, str] = field(default_factory=dict)
    vectors: list[tuple[int, list[str]]] = field(default_factory=list)
    matrices: list[tuple[int, str, str, list[str]]] = field(default_factory=list)
    unused: dict[str, None] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)

    def say(self, key: str, value: str, place: Place) -> None:
        """Add a metadata field; raises UserError for a duplicate."""
        if key in self.meta:
            place._replace(column=key).refuse("each keyword once in the metadata", "it twice")
        self.meta[key] = value


def check_version(text: str, place: Place, about: str = "OEM", versions: tuple[str, ...] = VERSIONS) -> None:
    """Raise UserError for an unknown version of a message."""
    if text not in versions:
        place.refuse(f"{about} version {', '.join(versions[:-1])} or {versions[-1]}", repr(text))


def ephemeris(block: MessageBlock, note: Note = refuse) -> Ephemeris:
    """Convert a block to numbers.

    Args:
        block: a segment as text.
        note: callback for invalid states, which are then skipped.

    Raises:
        UserError: missing content (the message gives the line number), or an error raised by `note`.
    """
    for key in REQUIRED:
        if not block.meta.get(key):
            block.place._replace(column=key).refuse("a value in the segment metadata", "none")
    file, system = block.place.file, canonical(block.meta["TIME_SYSTEM"].upper())
    utc, frame = system == "UTC", canonical(block.meta["REF_FRAME"].upper())
    rows, moments, states = [], [], []
    for row, cells in block.vectors:
        try:
            epoch = moment(cells[0], Place(file, row, "EPOCH"), utc=utc)
            numbers = values(cells[1:7], COMPONENTS, Place(file, row))
        except Fault as fault:
            note(fault)
        else:
            rows.append(row)
            moments.append(epoch)
            states.append(numbers)
    if not rows:
        block.place.refuse("a state in each segment", "none")
    kept = [k for k, useful in enumerate(useable(block, moments, note, utc=utc)) if useful]
    rows, moments, states = ([part[k] for k in kept] for part in (rows, moments, states))
    found = [covariance(block, k, moments[0], utc=utc) for k in range(len(block.matrices))]
    own = (frame, "")
    return Ephemeris(
        object_id=block.meta["OBJECT_ID"],
        object_name=block.meta.get("OBJECT_NAME", ""),
        center=canonical(block.meta["CENTER_NAME"].upper()),
        frame=frame,
        time_system=system,
        start=moments[0],
        times=np.array([(m - moments[0]) / epochs.SECOND for m in moments]),
        states=np.array(states),
        covariances=tuple(one._replace(frame="") if one.frame in own else one for one in found),
        rows=np.array(rows, dtype=np.int64),
        frame_epoch=block.meta.get("REF_FRAME_EPOCH", "") if frame not in FIXED else "",
    )


def useable(block: MessageBlock, moments: list[int], note: Note, *, utc: bool) -> list[bool]:
    """Return the mask of usable states; states outside the useable span only serve interpolation.

    Raises:
        UserError: an invalid span, or one without states.
    """
    chosen = [True] * len(moments)
    for names in SPANS:
        said = [block.meta.get(name, "") for name in names]
        places = [block.place._replace(column=name) for name in names]
        ends = [moment(text, at, utc=utc) if text else None for text, at in zip(said, places, strict=True)]
        low, high = (math.inf * sign if end is None else end for sign, end in zip((-1, 1), ends, strict=True))
        inside = [low - SLACK <= m <= high + SLACK for m in moments]
        count, span = inside.count(False), f"{names[0]} to {names[1]}"
        if names == SPANS[0] and count:
            what = f"{count} of {len(moments)} states lie outside {span}"
            note(Remark(block.place, what, "Correct the metadata, or leave the states out", "warning"))
        elif count:
            if count == len(moments):
                block.place.refuse(f"a state between {names[0]} and {names[1]}", "none")
            chosen = inside
            note(Remark(block.place, f"{count} of {len(moments)} states are outside {span} and not used"))
    return chosen


def remarks(blocks: list[MessageBlock], *, covariances: bool = True) -> list[Remark]:
    """Return remarks on unused content of segments.

    Args:
        blocks: segments.
        covariances: whether covariances are used.
    """
    names: dict[str, None] = {}
    found: list[Remark] = []
    for block in blocks:
        fixed = canonical(block.meta.get("REF_FRAME", "").upper()) in FIXED  # independent of a date
        unused = (*UNUSED, "REF_FRAME_EPOCH") if fixed else UNUSED
        names |= block.unused | {key: None for key in unused if key in block.meta}
        if (clock := canonical(block.meta.get("TIME_SYSTEM", "").upper())) not in CLOCKS:
            what = f"{clock or 'none'} is not a time system of CCSDS messages"
            found.append(Remark(block.place, what, f"Use one of {', '.join(CLOCKS)}", "warning"))
        for key in block.meta:
            if key not in (*USED, *UNUSED):
                what = f"{key} is not an OEM keyword and is ignored{nearest(key, USED)}"
                found.append(Remark(block.place, what, "Correct its name, or leave it out", "warning"))
    if not covariances and any(block.matrices for block in blocks):
        what = "covariances: used for a start, but not for training"
        found.append(Remark(Place(blocks[0].place.file), what))
    if names:
        found.append(Remark(Place(blocks[0].place.file), f"not used: {', '.join(names)}"))
    if lines := [line for block in blocks for line in block.comments]:
        more = f"; and {len(lines) - COMMENTS} more" if len(lines) > COMMENTS else ""
        found.append(Remark(Place(blocks[0].place.file), f"comments: {'; '.join(lines[:COMMENTS])}{more}"))
    return found


def covariance(block: MessageBlock, k: int, start: int, *, utc: bool) -> Covariance:
    """Return the k-th covariance of a block; raises UserError for an incomplete lower triangle."""
    row, epoch, frame, cells = block.matrices[k]
    place = Place(block.place.file, row, "EPOCH")
    if len(cells) != 21:
        place.refuse("the 21 numbers of the lower triangle of a covariance", f"{len(cells)}")
    frame = canonical(frame.upper())
    matrix = np.zeros((6, 6))
    matrix[np.tril_indices(6)] = values(cells, ("covariance",) * 21, place)
    full = matrix + np.tril(matrix, -1).T
    return Covariance((moment(epoch, place, utc=utc) - start) / epochs.SECOND, full, frame)


def moment(text: str, place: Place, *, utc: bool) -> int:
    """Parse an epoch to picoseconds; raises UserError."""
    try:
        return epochs.instant(text, utc=utc)
    except ValueError as error:
        place.refuse(str(error), repr(text))


def values(cells: list[str], names: tuple[str, ...], place: Place) -> list[float]:
    """Return the numbers in cells; raises UserError for other text."""
    found = [number(cell, place._replace(column=name), "") for cell, name in zip(cells, names, strict=True)]
    for name, value in zip(names, found, strict=True):
        if math.isnan(value):
            place._replace(column=name).refuse("a number", "none")
    return found


def contents(blocks: list[MessageBlock], *, of_starts: bool = False, note: Note = refuse) -> list[Content]:
    """Return each segment as a trajectory, with times since its first epoch.

    Args:
        blocks: segments.
        of_starts: whether only initial states are read, whose covariances are used elsewhere.
        note: callback for invalid states, times that do not increase, and unused content.

    Raises:
        UserError: an error raised by `note`.
    """
    found = []
    for block in blocks:
        one = ephemeris(block, note)
        values, title = (one.rows, one.times, one.states), one.object_name
        track = Track(one.object_id, block.place.file, *values, title=title)
        of_date = f" of {one.frame_epoch}" if one.frame_epoch else ""
        frame = f"{one.frame}{of_date}, {one.center}, {one.time_system}"
        found.append(of_orbits([ordered(track, "EPOCH", note)], frame, one.start))
    for remark in remarks(blocks, covariances=of_starts):
        note(remark)
    return found


def of_orbits(tracks: list[Track], frame: str, epoch: int) -> Content:
    """Return orbits in km and km/s, with times in seconds since an epoch in the time scale in `frame`."""
    units = Units("s", "km", "km/s", "km²/s²")
    names, rates, clock = ("x", "y", "z"), ("vx", "vy", "vz"), frame.rpartition(" ")[2].upper()
    return Content(names, rates, False, units, frame, tuple(tracks), epoch, clock)
