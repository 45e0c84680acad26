"""Precise orbits of several satellites: the Extended Standard Product 3 format, versions c and d.

Positions are in km and velocities in dm/s in an Earth-fixed frame. Source: S. Hilla, The Extended Standard
Product 3 Orbit Format (SP3-c, 2010; SP3-d, 2016), National Geodetic Survey.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.ephemeris import moment, of_orbits
from ahnn.data.files.samples import Track, ordered
from ahnn.data.files.table import Fault, Note, Place, Remark, refuse, within

TITLE = re.compile(r"#([a-d])([PV])\s*\d{4}[ \d]{3}")
CLOCKS = {"GPS": "GPS", "GAL": "GPS", "QZS": "GPS", "UTC": "UTC", "GLO": "UTC", "TAI": "TAI"}
"""Time systems and their time scales; other systems differ from these by seconds."""
TERRESTRIAL = ("ITR", "IER", "IGS", "IGB", "IGR", "IGC", "SLR", "WGS", "ECF", "ECEF")
"""Prefixes of frame names that agree with the ITRF to within centimetres."""
NEAREST, FARTHEST = 6.3e3, 1e6
"""Range of distances of a satellite from the Earth's centre in km."""
FASTEST = 12.0
"""Maximum velocity of an Earth satellite in km/s."""
MISSING = 999999.0


@dataclass
class Sp3Orbit:
    """Orbit of one satellite: line numbers, epochs, positions in km, and velocities in km/s if available."""

    rows: list[int] = field(default_factory=list)
    moments: list[int] = field(default_factory=list)
    positions: list[list[float]] = field(default_factory=list)
    velocities: list[list[float] | None] = field(default_factory=list)


def sp3_content(text: str, file: str, *, note: Note = refuse) -> Content:
    """Return the orbits of a file, with velocities if available for all positions.

    Args:
        text: text of the file.
        file: file name.
        note: callback for damaged lines, which are then skipped, and for unused content.

    Raises:
        UserError: no orbit, an unsupported time system or frame, or an error raised by `note`.
    """
    reader = _Sp3Reader(file, note)
    for row, line in enumerate(text.split("\n"), 1):
        if line.strip() and not reader.ended:
            try:
                reader.line(line, Place(file, row))
            except Fault as fault:
                if not reader.epochs:  # a wrong header invalidates everything
                    raise
                note(fault)
    return reader.content()


class _Sp3Reader:
    """Sequential reader of lines."""

    def __init__(self, file: str, note: Note) -> None:
        self.file, self.note = file, note
        self.count, self.clock, self.system = -1, "", ""
        self.moment: int | None = None
        self.epochs, self.absent, self.moved, self.predicted = 0, 0, 0, 0
        self.ended = False
        self.orbits: dict[str, Sp3Orbit] = {}
        self.last = ""

    def line(self, line: str, place: Place) -> None:
        """Read a line; raises UserError."""
        if self.count < 0:
            self.title(line, place)
        elif line.startswith("%c"):
            self.clock = self.clock or clock_of(line, place)
        elif line.startswith("*"):
            self.epoch(line, place)
        elif line[0] in "PV":
            (self.position if line[0] == "P" else self.velocity)(line, place)
        elif line.startswith("EOF"):
            self.ended = True
        elif not line.startswith(("#", "+", "%", "/", "EP", "EV")):
            place.refuse("a line of an SP3 orbit file", repr(line[:40]))

    def title(self, line: str, place: Place) -> None:
        """Read the first line: version, number of epochs and frame."""
        found = TITLE.match(line)
        if found is None or found[1] not in "cd":
            place.refuse("#c or #d, as in SP3 orbit files", repr(line[:3]), "Versions a and b are not read")
        self.count = int(within(line[32:39].strip(), place._replace(column="number of epochs"), 1, 1e8))
        self.system = line[46:51].strip()
        if not self.system.upper().startswith(TERRESTRIAL):
            expected = "a frame that rotates with the Earth, such as IGS20"
            place._replace(column="frame").refuse(expected, repr(self.system))

    def epoch(self, line: str, place: Place) -> None:
        """Read the time of the positions that follow."""
        self.moment, self.last = None, ""
        cells = line[1:].split()
        if not self.clock:
            place.refuse("a time system (%c) before the first epoch", "none")
        if len(cells) != 6 or not all(cell.isdigit() for cell in cells[:5]):
            place.refuse("year, month, day, hour, minute and second", repr(line[1:].strip()))
        year, month, day, hour, minute = (int(cell) for cell in cells[:5])
        second = within(cells[5], place, 0.0, 61.0)
        text = f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:011.8f}"
        self.moment = moment(text, place, utc=self.clock == "UTC")
        self.epochs += 1

    def position(self, line: str, place: Place) -> None:
        """Read a position in km; zeros mark a missing position."""
        name = line[1:4].replace(" ", "0")
        self.last = ""
        if self.moment is None:
            place.refuse("a readable epoch before it", "none")
        numbers = _numbers(line, place._replace(column=f"position of {name}"), MISSING + 1)
        if not any(numbers) or max(map(abs, numbers)) >= MISSING:
            self.absent += 1
            return
        distance = float(np.linalg.norm(numbers))
        if not NEAREST <= distance <= FARTHEST:
            expected = f"a distance of {NEAREST:g} to {FARTHEST:g} km from the centre of the Earth"
            place._replace(column=f"position of {name}").refuse(expected, f"{distance:.0f} km")
        orbit = self.orbits.setdefault(name, Sp3Orbit())
        orbit.rows.append(place.row)
        orbit.moments.append(self.moment)
        orbit.positions.append(numbers)
        orbit.velocities.append(None)
        self.last = name
        self.moved += line[78:79] == "M"
        self.predicted += line[79:80] == "P"

    def velocity(self, line: str, place: Place) -> None:
        """Read the velocity of the preceding position, given in dm/s."""
        name = line[1:4].replace(" ", "0")
        place = place._replace(column=f"velocity of {name}")
        if name != self.last:
            return self.absent_or_misplaced(line, place)
        numbers = [one * 1e-4 for one in _numbers(line, place, 1e4 * FASTEST * 10)]
        if any(numbers):
            if np.linalg.norm(numbers) > FASTEST:
                place.refuse(f"a velocity of at most {FASTEST:g} km/s", f"{np.linalg.norm(numbers):.1f} km/s")
            self.orbits[name].velocities[-1] = numbers
        return None

    def absent_or_misplaced(self, line: str, place: Place) -> None:
        """Skip the velocity of a missing position; raises UserError for any other velocity."""
        if any(_numbers(line, place, MISSING + 1)):
            place.refuse("a position of the satellite before its velocity", "none")

    def content(self) -> Content:
        """Return the orbits, with times since the earliest epoch."""
        place = Place(self.file)
        if not self.orbits:
            place.refuse("positions (lines P) in an SP3 orbit file", "none")
        if not self.ended or self.epochs != self.count:
            end = "" if self.ended else " without EOF"
            self.note(
                Fault(place, f"{self.count} epochs and EOF", f"{self.epochs}{end}", "The file is cut off")
            )
        for count, what in (
            (self.absent, "positions missing"),
            (self.moved, "positions of satellites that manoeuvre"),
            (self.predicted, "positions predicted"),
        ):
            if count:
                self.note(Remark(place, f"{what}: {count}"))
        self.note(
            Remark(place, f"frame {self.system} is treated as ITRF; clocks and accuracies are not used")
        )
        start = min(min(one.moments) for one in self.orbits.values())
        moving = all(None not in one.velocities for one in self.orbits.values())
        if not moving and any(any(v is not None for v in one.velocities) for one in self.orbits.values()):
            self.note(Remark(place, "velocities not used: missing at some positions"))
        tracks = [self.track(name, one, start, moving) for name, one in self.orbits.items()]
        found = of_orbits(tracks, f"ITRF, EARTH, {self.clock}", start)
        return found if moving else found._replace(rates=())

    def track(self, name: str, one: Sp3Orbit, start: int, moving: bool) -> Track:
        """Return the orbit of a satellite."""
        values = np.array(one.positions)
        if moving:
            values = np.concatenate((values, np.array(one.velocities, dtype=float)), axis=1)
        times = np.array([(moment - start) / epochs.SECOND for moment in one.moments])
        return ordered(Track(name, self.file, np.array(one.rows), times, values), "epoch", self.note)


def clock_of(line: str, place: Place) -> str:
    """Return the time scale of the epochs; raises UserError if unsupported."""
    system = line[9:12]
    if system not in CLOCKS:
        place._replace(column="time system").refuse(f"one of {', '.join(CLOCKS)}", repr(system))
    return CLOCKS[system]


def _numbers(line: str, place: Place, most: float) -> list[float]:
    """Return the three numbers of a line, of 14 columns each; raises UserError."""
    return [within(line[at : at + 14].strip(), place, -most, most) for at in (4, 18, 32)]
