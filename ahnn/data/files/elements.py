"""Two-line element sets, propagated by SGP4 to trajectories in TEME.

The columns are defined by Hoots and Roehrich, Spacetrack Report 3 (1980).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from datetime import date
from functools import partial
from typing import Any, NamedTuple

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.sgp4_orbits import MeanOrbit, sgp4_content
from ahnn.data.files.table import Fault, Note, Place, refuse

FIRST, SECOND = re.compile(r"1 [ \dA-Z]{5}[A-Z ] "), re.compile(r"2 [ \dA-Z]{5} ")
LENGTH = 69
"""Number of characters of a line; further characters are not part of the set."""
EPOCH = slice(18, 32)
ANGLE = re.compile(r" *\d+\.\d*")
FIELDS: tuple[tuple[str, int, slice, re.Pattern[str], float], ...] = (
    ("drag term", 0, slice(53, 61), re.compile(r"[ +-][ \d]{4}\d[+-]\d"), math.inf),
    ("ephemeris type", 0, slice(62, 63), re.compile(r"[ 0234]"), 3.0),
    ("inclination", 1, slice(8, 16), ANGLE, 180.0),
    ("node", 1, slice(17, 25), ANGLE, 360.0),
    ("eccentricity", 1, slice(26, 33), re.compile(r" *\d+"), math.inf),
    ("perigee", 1, slice(34, 42), ANGLE, 360.0),
    ("mean anomaly", 1, slice(43, 51), ANGLE, 360.0),
    ("mean motion", 1, slice(52, 63), ANGLE, 20.0),
)
"""Fields read by SGP4: line, columns, notation, and maximum; ephemeris type 4 belongs to SGP4-XP."""
DESIGNATOR = re.compile(r"(\d\d)(\d{3}[A-Z]{1,3}) *")
"""Year, number and piece of a launch, columns 10 to 17 of the first line."""
LONGEST_NAME = 24
UNUSED = "not used: classes, mean motion derivatives, set and revolution numbers"
"""Fields not needed by SGP4."""


class ElementSets(NamedTuple):
    """The two lines of a set, the place of the first, and the name in the line before, "" without one."""

    place: Place
    lines: tuple[str, str]
    title: str = ""


def content(
    text: str,
    file: str,
    step: float | None,
    duration: float | None,
    *,
    note: Note = refuse,
) -> Content:
    """Return a trajectory for each element set, starting at its epoch.

    Args:
        text: sets of two lines, or of three with a name before them.
        file: file name, for messages.
        step: seconds between samples.
        duration: duration of each trajectory in seconds.
        note: callback for sets that are damaged or cannot be propagated.

    Raises:
        UserError: no step or duration, no set, or an error raised by `note`.
    """
    expected = "an undamaged element set, whose lines begin with 1 and 2"
    read = partial(orbits_of, text, file)
    names = {"named": "element sets", "expected": expected, "unused": UNUSED}
    return sgp4_content(read, file, (step, duration), note=note, **names)


def orbits_of(text: str, file: str, model: Any, note: Note) -> Iterator[MeanOrbit]:
    """Yield the orbit of each set; sets with invalid numbers are reported to `note` and skipped."""
    for one in sets_of(text, file, note):
        try:
            name, satellite = one.lines[0][2:7].strip(), satellite_of(model, one)
            yield MeanOrbit(one.place, name, satellite, epoch(one), one.title, designator(one))
        except Fault as fault:
            note(fault)


def sets_of(text: str, file: str, note: Note) -> list[ElementSets]:
    """Return the sets of a text; other lines, such as comments, are ignored."""
    every = text.split("\n")
    lines = [(row, line) for row, line in enumerate(every, 1) if line[:2] in ("1 ", "2 ")]
    found: list[ElementSets] = []
    pending: tuple[int, str] | None = None
    damaged: set[int] = set()
    for row, line in lines:
        place = Place(file, row)
        if FIRST.match(line) is None and SECOND.match(line) is None:
            continue
        if (fault := fault_of(line, place)) is not None:
            note(fault)
            damaged.add(row)
        if line[0] == "1":
            if pending is not None:
                note(Fault(Place(file, pending[0]), "a line 2 after it", "none"))
            pending = row, line[:LENGTH]
        elif pending is None or pending[1][2:7] != line[2:7]:
            before = "none" if pending is None else repr(pending[1][2:7])
            note(Fault(place, f"a line 1 for {line[2:7]!r} before it", before))
            pending = None
        else:
            if not damaged & {pending[0], row}:
                title = title_of(every[pending[0] - 2] if pending[0] > 1 else "")
                found.append(ElementSets(place._replace(row=pending[0]), (pending[1], line[:LENGTH]), title))
            pending = None
    if pending is not None:
        note(Fault(Place(file, pending[0]), "a line 2 after it", "none"))
    return found


def title_of(line: str) -> str:
    """Return the name in the line before a set; "" for a remark, a line of another set, or an empty one."""
    name = line.removeprefix("0 ").strip()
    return "" if len(name) > LONGEST_NAME or line[:2] in ("1 ", "2 ") or name.startswith("#") else name


def designator(one: ElementSets) -> str:
    """Return the international designator of a set, such as 2014-069A; "" without a valid one."""
    found = DESIGNATOR.fullmatch(one.lines[0][9:17])
    return "" if found is None else f"{'19' if int(found[1]) >= 57 else '20'}{found[1]}-{found[2]}"


def fault_of(line: str, place: Place) -> Fault | None:
    """Return the error in length or checksum of a line, or None."""
    if len(line) < LENGTH:
        return Fault(place, f"{LENGTH} signs", f"{len(line)}")
    total = sum(int(sign) if sign.isdigit() else sign == "-" for sign in line[: LENGTH - 1]) % 10
    if line[LENGTH - 1] != str(total):
        return Fault(
            place._replace(column="checksum"), f"{total}", repr(line[LENGTH - 1]), "The line is damaged"
        )
    return None


def satellite_of(model: Any, one: ElementSets) -> Any:
    """Return the SGP4 satellite of a set; raises Fault for lines with invalid numbers."""
    for name, line, columns, notation, most in FIELDS:
        text = one.lines[line][columns]
        if not notation.fullmatch(text) or (most < math.inf and float(text.strip() or 0) > most):
            place = one.place._replace(row=one.place.row + line, column=name)
            place.refuse(f"a number up to {most:g}" if most < math.inf else "a number", repr(text))
    try:
        return model.Satrec.twoline2rv(*one.lines)
    except ValueError as error:
        one.place.refuse("an element set", " ".join(str(error).split()))


def epoch(one: ElementSets) -> int:
    """Return the epoch of a set (`epochs.instant`); two-digit years from 57 belong to the 20th century."""
    text = one.lines[0][EPOCH]
    try:
        year, day, fraction = (int(part) for part in (text[:2], text[2:5], text[6:].rstrip().ljust(8, "0")))
    except ValueError:
        one.place._replace(column="epoch").refuse("year and day", repr(text))
    year += 1900 if year >= 57 else 2000
    days = date(year, 1, 1).toordinal() + day - 1 - epochs.FIRST
    if not (day > 0 and days < date(year + 1, 1, 1).toordinal() - epochs.FIRST):
        one.place._replace(column="epoch").refuse("a day of the year", repr(text))
    return (days * epochs.DAY + epochs.leaps(days)) * epochs.SECOND + fraction * epochs.DAY * 10**4
