"""Laser ranging data of the ILRS: normal points of the Consolidated Laser Ranging Data Format (CRD).

Source: R. L. Ricklefs, C. J. Moore, Consolidated Laser Ranging Data Format (CRD), ILRS, 1.01 and 2.01.
Times of flight are two-way; the range is the speed of light times half the time of flight.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from ahnn.data.files import epochs
from ahnn.data.files.table import Fault, Note, Place, refuse, within
from ahnn.tracking.formats.crd_session import (
    NormalPoint,
    RangingSession,
    WeatherRecord,
    moment_near,
    weather_at,
)
from ahnn.tracking.formats.gathered import TrackingReading, gathered
from ahnn.tracking.formats.instants import calendar_days, day_moment
from ahnn.tracking.tracking_data import Event, TrackingData

LIGHT = 299792.458
"""Speed of light in km/s."""
EVENTS: dict[str, Event] = {"0": "receive", "1": "bounce", "2": "transmit"}
"""Epoch event of a two-way range (record 11)."""
STATION = re.compile(r"\s*(.*?)\s*(\d{4,5})\s+(\d+)\s+(\d+)\s+(\d+)(\s+\S+)?\s*")
TARGET = re.compile(r"\s*(.+?)\s+(\d+)\s+(-?\d+|na)\s+(-?\d+|na)\s+([012])\s+(\d)(\s+\S+)?\s*", re.IGNORECASE)
TYPES = {"0": "full-rate data", "2": "sampled engineering data"}
FLAGS = (
    (
        14,
        "0",
        "ranges not yet corrected for refraction",
        "Ask for normal points without this correction",
    ),
    (15, "0", "ranges to the reflectors, not to the centre of mass", ""),
    (17, "1", "ranges corrected for the station delay", ""),
    (19, "2", "two-way ranges (range type 2)", ""),
)
"""Requirements on a session (record H4): field index, required value, and its meaning."""
UNUSED = {
    "00": "comments",
    "10": "full-rate ranges",
    "12": "range supplements",
    "21": "weather supplements",
    "30": "pointing angles",
    "40": "calibrations",
    "41": "calibrations",
    "42": "calibrations",
    "50": "pass statistics",
    "60": "compatibility records",
    **{f"c{k}": "instrument descriptions" for k in range(1, 8)},
    "h5": "prediction names",
}
"""Records that are not needed; 90 to 99 are station-specific."""
SLACK = 120 * epochs.SECOND
"""Tolerance by which a normal point may lie outside the times of its session."""


def crd_data(text: str, file: str, note: Note = refuse) -> list[TrackingData]:
    """Return the normal points of all passes in a text; stations are named by their pads, such as 7941.

    Args:
        text: text of one or several concatenated files.
        file: file name.
        note: callback for damaged records, which are then skipped.

    Raises:
        UserError: no normal point, or a fault raised by `note`.
    """
    reader = _CrdReader(file, note)
    for row, line in enumerate(text.split("\n"), 1):
        if line.strip():
            try:
                reader.record(line.rstrip(), Place(file, row))
            except Fault as fault:
                note(fault)
    reader.close("the end of the file")
    if not reader.found:
        Place(file).refuse("normal points (records 11) in laser ranging data (CRD)", "none")
    remarks = reader.remarks()
    return [gathered(name, readings, event, remarks) for (name, event), readings in reader.found.items()]


class _CrdReader:
    """Sequential reader of records: header values remain valid until replaced."""

    def __init__(self, file: str, note: Note) -> None:
        self.file, self.note = file, note
        self.version, self.station, self.target = "", "", ""
        self.names: dict[str, str] = {}
        self.session: RangingSession | None = None
        self.ended, self.skipped = False, False
        self.found: dict[tuple[str, Event], list[TrackingReading]] = {}
        self.unused: dict[str, None] = {}
        self.readers: dict[str, Callable[[list[str], Place], None]] = {
            "c0": self.configuration,
            "11": self.point,
            "20": self.weather,
        }

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on unused content."""
        names = ", ".join(dict.fromkeys([*self.unused, "scatter and counts of normal points"]))
        cut_off = () if self.ended else ("no record H9 at the end: the file may be cut off",)
        return (f"not used: {names}", *cut_off)

    def record(self, line: str, place: Place) -> None:
        """Read a record; raises UserError."""
        key, rest = line.lstrip()[:2].lower(), line.lstrip()[2:]
        place = place._replace(column=f"record {key.upper()}")
        cells = rest.split()
        if key == "h1":
            self.format(cells, place)
        elif not self.version and key != "00":
            place.refuse("CRD record H1 first", repr(line[:40]))
        elif key in ("h2", "h3"):
            self.close("another header")
            self.header(key, rest, place)
        elif key == "h4":
            self.close("another session")
            self.begin(cells, place)
        elif key in ("h8", "h9"):
            self.finish()
            self.ended = self.ended or key == "h9"
        elif key in self.readers:
            if not self.skipped:
                self.readers[key](cells, place)
        elif key in UNUSED or key.startswith("9"):
            self.unused[UNUSED.get(key, "station records")] = None
        else:
            place.refuse("a CRD record", repr(line[:40]))

    def format(self, cells: list[str], place: Place) -> None:
        """Read record H1: the format and its version."""
        self.close("another file")
        self.station, self.target, self.ended = "", "", False
        version = cells[1].lstrip("0") if len(cells) > 1 else ""
        if cells[:1] not in (["CRD"], ["crd"]) or version not in ("1", "2"):
            self.skipped = True
            place.refuse("CRD version 1 or 2", repr(" ".join(cells[:2])))
        self.version = version

    def header(self, key: str, rest: str, place: Place) -> None:
        """Read the station or the satellite."""
        found = (STATION if key == "h2" else TARGET).fullmatch(rest)
        if found is None:
            self.skipped = True
            what = "name, pad, system, occupancy and clock of a station" if key == "h2" else "a satellite"
            place.refuse(f"{what}", repr(rest.strip()))
        if key == "h2":
            self.station = found[2]
            return
        if found[5] != "0" or found[6] in ("3", "4"):
            self.skipped = True
            place.refuse("a satellite with reflectors", f"a transponder ({rest.strip()!r})")
        self.target = self.names.setdefault(found[2], found[1])

    def begin(self, cells: list[str], place: Place) -> None:
        """Begin a session: its kind, times and corrections."""
        self.skipped = True
        if not (self.station and self.target):
            place.refuse("records H2 and H3 before a session", "none")
        if len(cells) < 21 or any(not cell.lstrip("-").isdigit() and cell != "na" for cell in cells[:21]):
            place.refuse("21 whole numbers", repr(" ".join(cells)))
        if cells[0] != "1":
            place.refuse("normal points (data type 1)", TYPES.get(cells[0], f"data type {cells[0]}"))
        for k, wanted, meaning, remedy in FLAGS:
            if cells[k] != wanted:
                place.refuse(meaning, f"{cells[k]} in field {k + 2}", remedy)
        start, stop = moment_of(cells[1:7], place), None
        if cells[7] not in ("-1", "na"):
            stop = moment_of(cells[7:13], place)
            if not start <= stop <= start + epochs.DAY * epochs.SECOND:
                place.refuse("a session of at most one day", "another end")
        self.session, self.skipped = RangingSession(start, stop, start), False

    def configuration(self, cells: list[str], place: Place) -> None:
        """Read record C0: the wavelength of a configuration, converted from nm to micrometres."""
        if len(cells) < 3:
            place.refuse("a wavelength and a configuration name", repr(" ".join(cells)))
        self.opened(place).wavelengths[cells[2]] = within(cells[1], place, 200.0, 12000.0) / 1000

    def weather(self, cells: list[str], place: Place) -> None:
        """Read record 20: pressure, temperature, and humidity in percent."""
        if len(cells) < 4:
            place.refuse("seconds, pressure, temperature and humidity", repr(" ".join(cells)))
        session = self.opened(place)
        within(cells[0], place, 0.0, 3 * epochs.DAY)
        pressure = within(cells[1], place, 300.0, 1200.0)
        temperature = within(cells[2], place, 180.0, 340.0)
        humidity = within(cells[3], place, 0.0, 105.0) / 100
        moment = moment_near(session.start, cells[0])
        session.weather.append(WeatherRecord(moment, (pressure, temperature, min(humidity, 1.0))))

    def point(self, cells: list[str], place: Place) -> None:
        """Read record 11: a normal point."""
        if len(cells) < 5:
            place.refuse("seconds, time of flight, configuration and epoch event", repr(" ".join(cells)))
        session = self.opened(place)
        event = EVENTS.get(cells[3])
        if event is None:
            place.refuse("epoch event 0, 1 or 2 for a two-way range", repr(cells[3]))
        within(cells[0], place, 0.0, 3 * epochs.DAY)
        flight = within(cells[1], place, 1e-4, 30.0)
        moment = moment_near(session.last, cells[0])
        before = moment < session.start - SLACK
        if before or (session.stop is not None and moment > session.stop + SLACK):
            place.refuse("a time within its session (H4)", repr(cells[0]))
        session.last = moment
        session.points.append(NormalPoint(moment, flight * LIGHT / 2, cells[2], event, place.row))

    def opened(self, place: Place) -> RangingSession:
        """Return the session that is open; raises UserError if none is open."""
        return self.session or place.refuse("record H4 before it", "none")

    def close(self, what: str) -> None:
        """End an open session, and note the fault that its last record is missing."""
        if self.session is not None:
            self.finish()
            self.note(Fault(Place(self.file), "record H8 at the end of each session", what))

    def finish(self) -> None:
        """Add the points of a session, with their weather and wavelength, to the result."""
        session, self.session, self.skipped = self.session, None, False
        if session is None:
            return
        known = session.wavelengths
        only = next(iter(known.values())) if len(known) == 1 else None
        weather = weather_at(session.weather, [one.moment for one in session.points])
        for one, air in zip(session.points, weather, strict=True):
            wavelength = known.get(one.configuration, only)
            if wavelength is None:
                place = Place(self.file, one.row, "record 11")
                self.note(Fault(place, "record C0 for its configuration", repr(one.configuration)))
                continue
            reading = TrackingReading(
                one.moment, self.station, {"range": one.range}, one.row, air, wavelength
            )
            self.found.setdefault((self.target, one.event), []).append(reading)


def moment_of(cells: list[str], place: Place) -> int:
    """Return the moment of a date and a time of day; raises UserError."""
    days = calendar_days(cells[:3], place)
    hour, minute, second = (
        within(cell, place, 0.0, most) for cell, most in zip(cells[3:6], (24, 59, 60), strict=True)
    )
    return day_moment(days) + int(3600 * hour + 60 * minute + second) * epochs.SECOND
