"""Segments of tracking data messages (CCSDS 503.0-B) as text, from keyword = value notation."""

from __future__ import annotations

from dataclasses import dataclass, field

from ahnn.arguments import nearest
from ahnn.data.files.ephemeris import check_version
from ahnn.data.files.oem import pair
from ahnn.data.files.table import Place

VERSION = "CCSDS_TDM_VERS"
VERSIONS = ("1.0", "2.0")
HEADER = ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
USED_DATA = ("RANGE", "DOPPLER_INSTANTANEOUS", "DOPPLER_INTEGRATED", "ANGLE_1", "ANGLE_2")
WEATHER = ("PRESSURE", "TEMPERATURE", "RHUMIDITY")
INDEXED = ("RECEIVE_FREQ", "RECEIVE_PHASE_CT", "TRANSMIT_FREQ", "TRANSMIT_FREQ_RATE", "TRANSMIT_PHASE_CT")
UNUSED_DATA = (
    *("CARRIER_POWER", "CLOCK_BIAS", "CLOCK_DRIFT", "DOPPLER_COUNT", "DOR", "MAG", "PC_N0", "PR_N0", "RCS"),
    *("RECEIVE_FREQ", "STEC", "TROPO_DRY", "TROPO_WET", "VLBI_DELAY"),
    *(f"{name}_{k}" for name in INDEXED for k in range(1, 6)),
)
"""Data keywords that are not used."""


@dataclass
class TdmSegment:
    """Content of a segment.

    Attributes:
        place: beginning of the segment.
        meta: metadata by keyword.
        records: line, keyword, epoch and value of each datum.
    """

    place: Place
    meta: dict[str, str] = field(default_factory=dict)
    records: list[tuple[int, str, str, str]] = field(default_factory=list)

    def say(self, key: str, value: str, place: Place) -> None:
        """Add a value to the metadata; raises UserError for a duplicate keyword."""
        if key in self.meta:
            place._replace(column=key).refuse("each keyword once in the metadata", "it twice")
        self.meta[key] = value

    def record(self, key: str, epoch: str, value: str, place: Place) -> None:
        """Add a record to the data; raises UserError for an unknown keyword."""
        known = (*USED_DATA, *WEATHER, *UNUSED_DATA)
        if key not in known:
            guess = nearest(key, known)
            guess = guess if "mean" in guess else ""  # the list of known keywords is incomplete
            place.refuse("a TDM data keyword", f"{key!r}{guess}")
        self.records.append((place.row, key, epoch, value))


def kvn_segments(text: str, file: str) -> list[TdmSegment]:
    """Return the segments of a message in keyword = value notation.

    Raises:
        UserError: unexpected content, with its line number.
    """
    lines = [(row, line.strip()) for row, line in enumerate(text.split("\n"), 1)]
    used = [(row, line) for row, line in lines if line and line.split()[0] != "COMMENT"]
    if not used or not used[0][1].startswith(VERSION):
        received = repr(used[0][1][:40]) if used else "no line"
        Place(file, used[0][0] if used else 0).refuse(f"{VERSION} first", received)
    first = Place(file, used[0][0])
    check_version(pair(used[0][1], first)[1], first, "TDM", VERSIONS)
    segments: list[TdmSegment] = []
    state = "header"
    for row, line in used[1:]:
        place = Place(file, row)
        if line == "META_START" and state in ("header", "between"):
            segments.append(TdmSegment(place))
            state = "meta"
        elif (line, state) in CHANGES:
            state = CHANGES[line, state]
        elif state == "header":
            if (key := pair(line, place)[0]) not in HEADER:
                place.refuse(f"{', '.join(HEADER)} or META_START", repr(key))
        elif state == "meta":
            segments[-1].say(*pair(line, place), place)
        elif state == "data":
            key, value = pair(line, place)
            cells = value.split()
            if len(cells) != 2:
                place.refuse("KEYWORD = epoch value", repr(line))
            segments[-1].record(key, cells[0], cells[1], place)
        else:
            place.refuse("DATA_START after META_STOP, META_START after DATA_STOP", repr(line))
    if state != "between" or segments[-1].place.row > used[-1][0]:
        Place(file, used[-1][0]).refuse("DATA_STOP at the end of a segment", "the end of the file")
    return segments


CHANGES = {
    ("META_STOP", "meta"): "ready",
    ("DATA_START", "ready"): "data",
    ("DATA_STOP", "data"): "between",
}
"""Next state of the parser, by line and current state."""
