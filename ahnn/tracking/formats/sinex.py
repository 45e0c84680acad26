"""Station positions and eccentricities from files in SINEX (Solution Independent Exchange) format.

Reads the blocks SOLUTION/ESTIMATE (positions of markers and their velocities), SOLUTION/EPOCHS (time spans of
solutions) and SITE/ECCENTRICITY (vectors from the marker to the reference point of measurements). Source:
SINEX format description, versions 1.00 to 2.10, IERS and ILRS.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import epochs
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Place, within
from ahnn.tracking.formats.instants import day_moment
from ahnn.tracking.formats.station_catalogue import Eccentricity, StationCatalogue, StationSolution

TITLE = re.compile(r"%=SNX\s+([12]\.\d\d?)\b")
TIME = re.compile(r"(\d{2}|\d{4}):(\d{3}):(\d{5})")
OFFSET = re.compile(r"\b(UNE|XYZ)(.{9})(.{9})(.{1,9})(?=\s|$)")
COORDINATES = ("STAX", "STAY", "STAZ")
RATES = ("VELX", "VELY", "VELZ")
UNIT = {**dict.fromkeys(COORDINATES, "m"), **dict.fromkeys(RATES, "m/y")}
NEAREST, FARTHEST = 6.33e6, 6.40e6
"""Range of geocentric distances in m of stations on the Earth."""


class SinexEstimate(NamedTuple):
    """Values of one solution for a point, by type, with their reference epoch."""

    place: Place
    reference: int
    values: dict[str, float]


@dataclass
class _Blocks:
    """Content of the blocks of one file, by point and solution number."""

    estimates: dict[tuple[str, str], SinexEstimate] = field(default_factory=dict)
    spans: dict[tuple[str, str], tuple[int | None, int | None]] = field(default_factory=dict)
    eccentricities: dict[str, list[Eccentricity]] = field(default_factory=dict)
    unused: dict[str, None] = field(default_factory=dict)


def read_sinex(*paths: str | Path) -> StationCatalogue:
    """Read the stations of one or several files, for example positions and eccentricities separately.

    Raises:
        UserError: an invalid line, with its number, a file with neither, or a station in two files.
    """
    found = StationCatalogue()
    for path in map(Path, paths):
        one = sinex_stations(decoded(content_of(path), path), str(path))
        for name, mine, theirs in (
            ("positions", found.solutions, one.solutions),
            ("eccentricities", found.eccentricities, one.eccentricities),
        ):
            if twice := sorted(mine.keys() & theirs.keys()):
                Place(str(path)).refuse(f"{name} of a station in only one file", f"{twice[0]} in two files")
        found.solutions.update(one.solutions)
        found.eccentricities.update(one.eccentricities)
        found.unused.update(one.unused)
    return found


def sinex_stations(text: str, file: str) -> StationCatalogue:
    """Return the stations of a file.

    Raises:
        UserError: an invalid line, with its number, or a file with neither positions nor eccentricities.
    """
    lines = text.split("\n")
    if not TITLE.match(lines[0]):
        Place(file, 1).refuse("%=SNX and version 1 or 2", repr(lines[0][:40]))
    blocks, block, ended = _Blocks(), "", False
    for row, line in enumerate(lines[1:], 2):
        place = Place(file, row, block)
        if line.startswith("%"):
            ended = ended or line.startswith("%ENDSNX")
        elif line.startswith("+"):
            if block:
                place.refuse(f"-{block} before another block", repr(line.strip()))
            block = line[1:].strip()
            if block not in READERS:
                blocks.unused[block] = None
        elif line.startswith("-"):
            if line[1:].strip() != block:
                place.refuse(f"-{block}" if block else "a block before its end", repr(line.strip()))
            block = ""
        elif line.strip() and not line.startswith("*") and block in READERS:
            READERS[block](blocks, line, place)
    if not ended or block:
        Place(file).refuse("%ENDSNX at the end", "none", "The file is cut off")
    if not (blocks.estimates or blocks.eccentricities):
        Place(file).refuse(f"one of the blocks {', '.join(READERS)} with stations", "none")
    return StationCatalogue(_solutions(blocks), blocks.eccentricities, blocks.unused)


def _estimate(blocks: _Blocks, line: str, place: Place) -> None:
    """Read a line of SOLUTION/ESTIMATE; parameters that do not belong to stations are skipped."""
    cells = line.split()
    if len(cells) < 2 or cells[1] not in UNIT:
        if len(cells) < 9 or not cells[0].isdigit():
            place.refuse("index, type, code, point, solution, epoch, unit, constraint and value", repr(cells))
        blocks.unused[f"{cells[1]} of SOLUTION/ESTIMATE"] = None
        return
    if len(cells) < 9:
        place.refuse("index, type, code, point, solution, epoch, unit, constraint and value", repr(cells))
    kind, key = cells[1], (point_of(cells[2], cells[3]), cells[4])
    reference = sinex_moment(cells[5], place)
    if reference is None or cells[6] != UNIT[kind]:
        place.refuse(f"an epoch, and {kind} in {UNIT[kind]}", f"{cells[5]} and {cells[6]}")
    low, high = (-FARTHEST, FARTHEST) if kind in COORDINATES else (-10.0, 10.0)
    value = within(cells[8], place._replace(column=f"{kind} of {cells[2]}"), low, high)
    one = blocks.estimates.setdefault(key, SinexEstimate(place, reference, {}))
    if kind in one.values or one.reference != reference:
        place.refuse(f"each type once per solution, at one epoch ({kind} of {cells[2]})", "a second")
    one.values[kind] = value


def _span(blocks: _Blocks, line: str, place: Place) -> None:
    """Read a line of SOLUTION/EPOCHS."""
    cells = line.split()
    if len(cells) < 6:
        place.refuse("code, point, solution, technique, start and end", repr(" ".join(cells)))
    start, end = sinex_moment(cells[4], place), sinex_moment(cells[5], place)
    if start is not None and end is not None and end < start:
        place.refuse("an end after the start", f"{cells[4]} to {cells[5]}")
    blocks.spans[point_of(cells[0], cells[1]), cells[2]] = start, end


def _eccentricity(blocks: _Blocks, line: str, place: Place) -> None:
    """Read a line of SITE/ECCENTRICITY; each number has nine characters, and blanks may be missing."""
    found = OFFSET.search(line)
    cells = line[: found.start()].split() if found else []
    if found is None or len(cells) != 6:
        place.refuse("code, point, solution, technique, start, end, UNE or XYZ and three numbers", repr(line))
    start, end = sinex_moment(cells[4], place), sinex_moment(cells[5], place)
    if start is not None and end is not None and end < start:
        place.refuse("an end after the start", f"{cells[4]} to {cells[5]}")
    first, second, third = (within(found[k].strip(), place, -2e4, 2e4) / 1000 for k in (2, 3, 4))
    one = Eccentricity(start, end, (first, second, third), local=found[1] == "UNE")
    blocks.eccentricities.setdefault(point_of(cells[0], cells[1]), []).append(one)


READERS: dict[str, Callable[[_Blocks, str, Place], None]] = {
    "SOLUTION/ESTIMATE": _estimate,
    "SOLUTION/EPOCHS": _span,
    "SITE/ECCENTRICITY": _eccentricity,
}


def _solutions(blocks: _Blocks) -> dict[str, list[StationSolution]]:
    """Return the solutions of each point in order of time; raises UserError for an invalid solution."""
    found: dict[str, list[StationSolution]] = {}
    for (point, number), one in blocks.estimates.items():
        position = _vector(one, COORDINATES)
        known = any(name in one.values for name in RATES)
        velocity = _vector(one, RATES) if known else np.zeros(3)
        if not NEAREST <= (distance := float(np.linalg.norm(position))) <= FARTHEST:
            expected = f"a station on the Earth ({point}), {NEAREST:g} to {FARTHEST:g} m from its centre"
            one.place.refuse(expected, f"{distance:.0f} m")
        start, end = blocks.spans.get((point, number), (None, None))
        solution = StationSolution(one.reference, position / 1000, velocity / 1000, start, end)
        found.setdefault(point, []).append(solution)
    return {point: sorted(ones, key=lambda one: one.start or 0) for point, ones in found.items()}


def _vector(one: SinexEstimate, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Return three values; raises UserError if one is missing."""
    for name in names:
        if name not in one.values:
            one.place._replace(column=name).refuse("all three coordinates of the solution", "none")
    return np.array([one.values[name] for name in names])


def point_of(code: str, point: str) -> str:
    """Return the name of a point: the code of its site, such as 7090, and the point code unless it is A."""
    return code if point == "A" else f"{code} {point}"


def sinex_moment(text: str, place: Place) -> int | None:
    """Return the moment of an epoch such as 10:001:00000; None for day 0, which marks an open span.

    Two-digit years are from 1951 to 2050.

    Raises:
        UserError: invalid notation.
    """
    found = TIME.fullmatch(text)
    if found is None:
        place.refuse("an epoch YY:DDD:SSSSS", repr(text))
    year, day, second = int(found[1]), int(found[2]), int(found[3])
    if len(found[1]) == 2:
        year += 2000 if year <= 50 else 1900
    if day == 0:
        return None
    if not (1951 <= year < 2200 and day <= 366 and second <= epochs.DAY):
        place.refuse("a valid epoch YY:DDD:SSSSS", repr(text))
    return day_moment(date(year, 1, 1).toordinal() + day - 1) + second * epochs.SECOND
