"""Predicted orbits of the ILRS: the Consolidated Laser Ranging Prediction Format, versions 1 and 2.

Source: R. L. Ricklefs, Consolidated Laser Ranging Prediction Format, versions 1.01 and 2.00, ILRS. Positions
are in metres in an Earth-fixed frame, epochs in UTC.
"""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.ephemeris import of_orbits
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.samples import Track, ordered
from ahnn.data.files.table import Fault, Note, Place, Remark, refuse, within

FRAMES = {
    "0": "ITRF, EARTH, UTC",
    "1": "an inertial frame, true of date",
    "2": "an inertial frame, mean of J2000",
}
"""Reference frame code of record H2; only the first is read."""
MJD = date(1858, 11, 17).toordinal()
"""Ordinal of day 0 of the modified Julian date."""
FIRST_DAY, LAST_DAY = 41317.0, 125000.0
"""Range of modified Julian dates, from 1972 to 2201."""
FARTHEST = 2e9
"""Maximum distance in metres; the Moon is at 4e8."""
FASTEST = 3e5
"""Maximum speed in m/s; a body at `FARTHEST` has half of it in an Earth-fixed frame."""
UNUSED = {
    "00": "comments",
    "h3": "expected accuracies",
    "h4": "transponders",
    "h5": "distance of the reflectors from the centre of mass",
    "30": "light-path corrections",
    "40": "transponders",
    "50": "target offsets",
    "60": "satellite rotation",
    "70": "Earth orientation",
}


def read_cpf(path: str | Path) -> Content:
    """Read the orbit of a prediction in km, with times since its epoch.

    Raises:
        UserError: invalid content; the message gives its line number.
    """
    path = Path(path)
    return cpf_content(decoded(content_of(path), path), str(path))


def cpf_content(text: str, file: str, *, note: Note = refuse) -> Content:
    """Return the orbit of a prediction, with velocities if every position has one.

    Args:
        text: text of the file.
        file: file name.
        note: callback for damaged records, which are then skipped, and for unused content.

    Raises:
        UserError: no orbit in a supported frame, or an error raised by `note`.
    """
    reader = _CpfReader(file)
    for row, line in enumerate(text.split("\n"), 1):
        if line.strip() and not reader.ended:
            try:
                reader.record(line, Place(file, row))
            except Fault as fault:
                if not reader.rows:  # a wrong header invalidates everything
                    raise
                note(fault)
    if not reader.rows:
        Place(file).refuse("positions (records 10) of a laser ranging prediction (CPF)", "none")
    if not reader.ended:
        note(Fault(Place(file), "record 99 at the end", "none", "The file is cut off"))
    if reader.unused:
        note(Remark(Place(file), f"not used: {', '.join(reader.unused)}"))
    return reader.content(note)


class _CpfReader:
    """Sequential reader of records."""

    def __init__(self, file: str) -> None:
        self.file, self.name, self.headed, self.ended = file, "", False, False
        self.rows: list[int] = []
        self.moments: list[int] = []
        self.positions: list[list[float]] = []
        self.velocities: dict[int, list[float]] = {}
        self.unused: dict[str, None] = {}

    def record(self, line: str, place: Place) -> None:
        """Read a record; raises UserError."""
        key, cells = line.lstrip()[:2].lower(), line.lstrip()[2:].split()
        place = place._replace(column=f"record {key.upper()}")
        if key == "h1":
            self.format(cells, place)
        elif key == "h2":
            self.frame(cells, place)
        elif key == "10":
            self.position(cells, place)
        elif key == "20":
            self.velocity(cells, place)
        elif key == "99":
            self.ended = True
        elif key in UNUSED:
            self.unused[UNUSED[key]] = None
        elif key != "h9":
            place.refuse("a CPF record", repr(line[:40]))

    def format(self, cells: list[str], place: Place) -> None:
        """Read record H1: version and name of the satellite."""
        if cells[:1] not in (["CPF"], ["cpf"]) or cells[1:2] not in (["1"], ["2"], ["01"], ["02"]):
            place.refuse("CPF version 1 or 2", repr(" ".join(cells[:2])))
        at = 8 + int(cells[1]) - 1  # version 2 adds the sequence number of the prediction within its day
        if len(cells) <= at:
            place.refuse("source, date, numbers and satellite name", repr(" ".join(cells)))
        self.name = cells[at]

    def frame(self, cells: list[str], place: Place) -> None:
        """Read record H2: the frame; raises UserError for frames that are not Earth-fixed."""
        if len(cells) < 20:
            place.refuse("20 fields", f"{len(cells)}")
        if cells[18] != "0":
            place.refuse(
                "positions in a frame that rotates with the Earth (0)", FRAMES.get(cells[18], cells[18])
            )
        if len(cells) > 20 and cells[20] == "1":
            self.unused["the flag that positions refer to the reflectors instead of the centre of mass"] = (
                None
            )
        self.headed = True

    def position(self, cells: list[str], place: Place) -> None:
        """Read record 10: a position."""
        if not (self.headed and self.name):
            place.refuse("records H1 and H2 first", "none")
        if len(cells) != 7:
            place.refuse("direction, day, seconds, leap second and three coordinates", f"{len(cells)} values")
        if cells[0] != "0":
            place.refuse("instantaneous positions (direction 0)", repr(cells[0]))
        if cells[3] != "0":
            place.refuse("no leap second (0)", repr(cells[3]))
        day = within(cells[1], place, FIRST_DAY, LAST_DAY)
        if day != int(day):
            place.refuse("a modified Julian date in whole days", repr(cells[1]))
        seconds = within(cells[2], place, 0.0, 86401.0)
        place_of = [within(cell, place, -FARTHEST, FARTHEST) / 1000 for cell in cells[4:7]]
        start = epochs.instant(date.fromordinal(MJD + int(day)).isoformat(), utc=True)
        self.rows.append(place.row)
        self.moments.append(start + round(seconds * 1e9) * (epochs.SECOND // 10**9))
        self.positions.append(place_of)

    def velocity(self, cells: list[str], place: Place) -> None:
        """Read record 20: the velocity at the position before it."""
        if not self.rows or len(cells) != 4:
            place.refuse("direction and three velocities after a position", f"{len(cells)} values")
        numbers = [within(cell, place, -FASTEST, FASTEST) / 1000 for cell in cells[1:]]
        self.velocities[len(self.rows) - 1] = numbers

    def content(self, note: Note) -> Content:
        """Return the orbit, with times since its first epoch."""
        start, values = self.moments[0], np.array(self.positions)
        moving = len(self.velocities) == len(self.rows)
        if moving:
            values = np.concatenate((values, list(self.velocities.values())), axis=1)
        elif self.velocities:
            note(Remark(Place(self.file), "velocities not used: missing at some positions"))
        times = np.array([(one - start) / epochs.SECOND for one in self.moments])
        track = Track(self.name, self.file, np.array(self.rows), times, values)
        orbit = of_orbits([ordered(track, "record 10", note)], FRAMES["0"], start)
        return orbit if moving else orbit._replace(rates=())
