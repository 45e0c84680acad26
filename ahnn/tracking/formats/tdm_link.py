"""Interpretation of TDM segment metadata: participants, path, units and corrections."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NoReturn

from ahnn.arguments import nearest
from ahnn.data.files.frame_names import INERTIAL, canonical
from ahnn.data.files.table import Place, within
from ahnn.tracking.formats.instants import CLOCKS
from ahnn.tracking.formats.tdm_segment import TdmSegment
from ahnn.tracking.tracking_data import Event, Kind

LIGHT = 299792.458
"""Speed of light in km/s."""
ANGLES: dict[str, tuple[Kind, Kind]] = {
    "AZEL": ("azimuth", "elevation"),
    "RADEC": ("right_ascension", "declination"),
}
NUMBERED = ("PARTICIPANT", "TRANSMIT_DELAY", "RECEIVE_DELAY", "EPHEMERIS_NAME")
CORRECTED = {
    "CORRECTION_RANGE": ("RANGE",),
    "CORRECTION_DOPPLER": ("DOPPLER_INSTANTANEOUS", "DOPPLER_INTEGRATED"),
    "CORRECTION_ANGLE_1": ("ANGLE_1",),
    "CORRECTION_ANGLE_2": ("ANGLE_2",),
}
"""Correction keywords, and the data to which they are added."""
OTHER_CORRECTIONS = (
    *("CORRECTION_MAG", "CORRECTION_RCS", "CORRECTION_RECEIVE", "CORRECTION_TRANSMIT"),
    *("CORRECTION_ABERRATION_YEARLY", "CORRECTION_ABERRATION_DIURNAL"),
)
KNOWN = (
    *("TRACK_ID", "DATA_TYPES", "TIME_SYSTEM", "START_TIME", "STOP_TIME", "MODE", "PATH", "PATH_1", "PATH_2"),
    *("TRANSMIT_BAND", "RECEIVE_BAND", "TURNAROUND_NUMERATOR", "TURNAROUND_DENOMINATOR", "TIMETAG_REF"),
    *("INTEGRATION_INTERVAL", "INTEGRATION_REF", "FREQ_OFFSET", "RANGE_MODE", "RANGE_MODULUS", "RANGE_UNITS"),
    *("ANGLE_TYPE", "REFERENCE_FRAME", "INTERPOLATION", "INTERPOLATION_DEGREE", "DOPPLER_COUNT_BIAS"),
    *("DOPPLER_COUNT_SCALE", "DOPPLER_COUNT_ROLLOVER", "DATA_QUALITY", "CORRECTIONS_APPLIED"),
    *(f"{name}_{k}" for name in NUMBERED for k in range(1, 6)),
    *CORRECTED,
    *OTHER_CORRECTIONS,
)
"""Metadata keywords."""


@dataclass
class TdmLink:
    """Interpretation of the data of a segment.

    Attributes:
        station, satellite: the last two participants of the path.
        clock: time scale of the epochs.
        event: event tagged by the epochs.
        ways: number of ways of the link: 1 for satellite to station, 2 for a round trip.
        two_way: part of the round trip that two-way ranges and rates measure, half or whole.
        units: units of ranges.
        angles: kinds of the two angles, or None.
        middle: seconds from the time tag of an integrated Doppler to the middle of its interval.
        interval: integration interval in seconds; 0 if unspecified.
        corrections: corrections to be added to the data, by data keyword, in the unit of the data.
        blocked: keywords of unreadable data, with expected and received metadata.
        remarks: remarks on unused content and on noteworthy interpretations.
    """

    station: str
    satellite: str
    clock: str
    event: Event
    ways: int
    two_way: str
    units: str
    angles: tuple[Kind, Kind] | None
    middle: float = 0.0
    interval: float = 0.0
    corrections: dict[str, float] = field(default_factory=dict)
    blocked: dict[str, tuple[str, str]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def range_factor(self, place: Place) -> float:
        """Return the factor from a range to half the path in km; raises UserError for unreadable ranges."""
        self.require("RANGE", place)
        return self.half(place) * (LIGHT if self.units == "s" else 1.0)

    def rate_factor(self, key: str, place: Place) -> float:
        """Return the factor from a rate to that of half the path, km/s; raises UserError if unreadable."""
        if key == "DOPPLER_INTEGRATED":
            self.require(key, place)
        return self.half(place)

    def half(self, place: Place) -> float:
        """Return the factor from a measurement to half the path; raises UserError for a one-way link."""
        if self.ways != 2:
            place.refuse("a two-way link (PATH = 1,2,1)", "a one-way link, which depends on two clocks")
        return 0.5 if self.two_way == "whole" else 1.0

    def angle(self, key: str, place: Place) -> Kind:
        """Return the kind of angle of a keyword; raises UserError if unspecified."""
        self.require("ANGLE_1", place)
        assert self.angles is not None
        return self.angles[0 if key == "ANGLE_1" else 1]

    def require(self, key: str, place: Place) -> None:
        """Raise UserError for data that cannot be read because of their metadata."""
        if key in self.blocked:
            place.refuse(*self.blocked[key])


def link_of(segment: TdmSegment, two_way: str) -> TdmLink:
    """Determine the interpretation of a segment; raises UserError for unsupported segments."""
    meta, place = segment.meta, segment.place
    if (mode := meta.get("MODE", "SEQUENTIAL")) != "SEQUENTIAL":
        _wrong(place, "MODE", "SEQUENTIAL", mode, "Differenced data are not read")
    station, satellite, ways = _participants(meta, place)
    reference = meta.get("TIMETAG_REF", "RECEIVE")
    if reference not in ("RECEIVE", "TRANSMIT"):
        _wrong(place, "TIMETAG_REF", "RECEIVE or TRANSMIT", reference)
    event: Event = "transmit" if reference == "TRANSMIT" and ways == 2 else "receive"
    units = meta.get("RANGE_UNITS", "km")
    angles = ANGLES.get(meta.get("ANGLE_TYPE", ""))
    link = TdmLink(station, satellite, tdm_clock(segment), event, ways, two_way, units, angles)
    _judge_ranges(link, meta, place)
    _judge_angles(link, meta)
    _judge_integration(link, meta, place)
    _judge_corrections(link, meta, place)
    if any(key.startswith(("RANGE", "DOPPLER")) for _, key, _, _ in segment.records) and ways == 2:
        link.remarks.append(f"ranges and rates of two-way links are assumed to be for {_way(two_way)}")
    if meta.get("DATA_QUALITY") == "DEGRADED":
        link.remarks.append("DATA_QUALITY = DEGRADED")
    for key in meta:
        if key not in KNOWN:
            link.remarks.append(f"{key} is not a TDM keyword and is ignored{nearest(key, KNOWN)}")
    return link


def _way(two_way: str) -> str:
    return "the round trip" if two_way == "whole" else "half the round trip"


def tdm_clock(segment: TdmSegment) -> str:
    """Return the time scale of a segment; raises UserError if unsupported."""
    clock = segment.meta.get("TIME_SYSTEM", "").upper()
    if clock not in CLOCKS:
        _wrong(segment.place, "TIME_SYSTEM", f"one of {', '.join(CLOCKS)}", clock or "none")
    return clock


def _participants(meta: dict[str, str], place: Place) -> tuple[str, str, int]:
    """Return station, satellite and ways of a link; raises UserError for other paths."""
    path = [part.strip() for part in meta.get("PATH", "").split(",")]
    there_and_back = len(path) == 3 and path[0] == path[2] != path[1]
    if not there_and_back and not (len(path) == 2 and path[0] != path[1]):
        _wrong(
            place,
            "PATH",
            "1,2 or 1,2,1",
            meta.get("PATH") or "none",
            "Relayed and three-way links are not read",
        )
    names = [meta.get(f"PARTICIPANT_{part}", "") for part in path]
    if not all(names):
        _wrong(place, "PATH", "named participants", meta["PATH"])
    return names[-1], names[-2], len(path) - 1


def _judge_ranges(link: TdmLink, meta: dict[str, str], place: Place) -> None:
    """Block ranges that are ambiguous, in station-specific units, or that include delays."""
    if link.units not in ("km", "s"):
        link.blocked["RANGE"] = "RANGE_UNITS = km or s", repr(link.units)
    if _number(meta, "RANGE_MODULUS", place) != 0:
        link.blocked["RANGE"] = "unambiguous ranges (RANGE_MODULUS = 0)", repr(meta["RANGE_MODULUS"])
    for k in range(1, 6):
        for name in ("TRANSMIT_DELAY", "RECEIVE_DELAY"):
            if _number(meta, f"{name}_{k}", place) != 0:
                link.blocked["RANGE"] = (
                    "ranges without delays",
                    f"{name}_{k} = {meta[f'{name}_{k}']}",
                )


def _judge_angles(link: TdmLink, meta: dict[str, str]) -> None:
    """Block angles of unsupported types or frames."""
    if link.angles is None:
        link.blocked["ANGLE_1"] = f"ANGLE_TYPE = {' or '.join(ANGLES)}", repr(meta.get("ANGLE_TYPE", ""))
    elif link.angles == ANGLES["RADEC"]:
        frame = canonical(meta.get("REFERENCE_FRAME", "").upper())
        if frame not in (*INERTIAL, "ICRF"):
            link.blocked["ANGLE_1"] = "REFERENCE_FRAME = EME2000, ICRF or GCRF", repr(frame)
        else:
            link.remarks.append(f"right ascension and declination of {frame}")


def _judge_integration(link: TdmLink, meta: dict[str, str], place: Place) -> None:
    """Find the middle of the interval of integrated Doppler; block it if the interval is unclear."""
    parts = {"START": 0.5, "MIDDLE": 0.0, "END": -0.5}
    link.interval = _number(meta, "INTEGRATION_INTERVAL", place)
    reference = meta.get("INTEGRATION_REF", "")
    if not 0 < link.interval <= 86400 or reference not in parts:
        received = f"{meta.get('INTEGRATION_INTERVAL', 'none')} and {reference or 'none'}"
        link.blocked["DOPPLER_INTEGRATED"] = "INTEGRATION_INTERVAL and INTEGRATION_REF", received
        return
    link.middle = parts[reference] * link.interval


def _judge_corrections(link: TdmLink, meta: dict[str, str], place: Place) -> None:
    """Find corrections not yet applied to the data; raises UserError if this is unclear."""
    given = {key: _number(meta, key, place) for key in (*CORRECTED, *OTHER_CORRECTIONS) if key in meta}
    if not given:
        return
    applied = meta.get("CORRECTIONS_APPLIED", "")
    if applied not in ("YES", "NO"):
        _wrong(place, "CORRECTIONS_APPLIED", "YES or NO if corrections are given", applied or "none")
    if applied == "NO":
        for key, value in given.items():
            link.corrections |= dict.fromkeys(CORRECTED.get(key, ()), value)
        left = [key for key, value in given.items() if key in OTHER_CORRECTIONS and value != 0]
        link.remarks += [f"not applied: {', '.join(left)}"] if left else []


def _number(meta: dict[str, str], key: str, place: Place) -> float:
    """Return the number given for a keyword, 0 if absent; raises UserError for other values."""
    return within(meta[key], place._replace(column=key), -1e30, 1e30) if key in meta else 0.0


def _wrong(place: Place, key: str, expected: str, received: str, remedy: str = "") -> NoReturn:
    """Raise UserError for the value of a keyword."""
    place._replace(column=key).refuse(expected, received, remedy)
