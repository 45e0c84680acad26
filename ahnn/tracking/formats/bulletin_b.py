"""IERS Bulletins B: daily polar motion and UT1 - UTC, in the format since 2010.

Section 1 of a bulletin has a line for each day at 0 h UTC: final values of a month and a preliminary
extension.
Source: explanatory note of Bulletin B, Earth Orientation Centre of the IERS, Paris Observatory.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Place, within
from ahnn.tracking.formats.instants import MJD, calendar_days

TITLE = re.compile(r"\s*BULLETIN B \d+", re.IGNORECASE)
SECTION = re.compile(r"\s*(\d)\s+-\s+\S")
UNITS = re.compile(r"milliarcsecond.*millisecond", re.IGNORECASE)
DAY = re.compile(r"\s*\d{4}\s+\d{1,2}\s+\d{1,2}\s")


class EarthOrientation(NamedTuple):
    """Orientation of the Earth at 0 h UTC of consecutive days.

    Attributes:
        mjd: (D,) modified Julian dates, increasing.
        x, y: (D,) coordinates of the pole in arcseconds.
        ut1_utc: (D,) UT1 - UTC in seconds.
        pole: (D, 2) offsets dX, dY of the celestial pole from IAU 2006/2000A in arcseconds.
        final: (D,) whether the values are final instead of preliminary.
    """

    mjd: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    ut1_utc: NDArray[np.float64]
    pole: NDArray[np.float64]
    final: NDArray[np.bool_]


def read_bulletins(paths: str | Path | Sequence[str | Path]) -> EarthOrientation:
    """Read the daily values of one or several bulletins; in overlaps final values take precedence.

    Raises:
        UserError: an invalid line, with its number, or missing days between bulletins.
    """
    names = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    rows: dict[int, tuple[float, ...]] = {}
    for path in names:
        for row in bulletin_rows(decoded(content_of(path), path), str(path)):
            if int(row[0]) not in rows or row[6] >= rows[int(row[0])][6]:
                rows[int(row[0])] = row
    table = np.array([rows[day] for day in sorted(rows)])
    if len(gap := np.flatnonzero(np.diff(table[:, 0]) != 1)):
        day = int(table[gap[0], 0])
        Place(str(names[-1])).refuse(
            f"bulletins for consecutive days: MJD {day + 1} after MJD {day}", "a gap"
        )
    mas = table[:, 1:6] / 1000
    return EarthOrientation(table[:, 0], mas[:, 0], mas[:, 1], mas[:, 2], mas[:, 3:5], table[:, 6] > 0)


def bulletin_rows(text: str, file: str) -> list[tuple[float, ...]]:
    """Return the days of section 1: MJD, x, y, UT1 - UTC, dX, dY in mas and ms, and 1 for final values.

    Raises:
        UserError: a different file format, other units, or an invalid line.
    """
    lines = list(enumerate(text.split("\n"), 1))
    if not any(TITLE.match(line) for _, line in lines[:10]):
        Place(file).refuse("an IERS Bulletin B", repr(text[:40].strip()))
    section, known, final, rows = "", False, 1.0, list[tuple[float, ...]]()
    for row, line in lines:
        if found := SECTION.match(line):
            section = found[1]
        if section == "1":
            known = known or bool(UNITS.search(line))
            final = 0.0 if "preliminary" in line.lower() else final
            if DAY.match(line):
                if not known:
                    Place(file, row).refuse("units mas and ms before the values", "none")
                rows.append((*_values(line.split(), Place(file, row)), final))
                if len(rows) > 1 and rows[-1][0] != rows[-2][0] + 1:
                    Place(file, row, "MJD").refuse("the day after the previous line's", f"{rows[-1][0]:.0f}")
    if not rows or not section.isdigit() or int(section) < 2:
        Place(file).refuse("section 1 with daily values, and section 2 after it", "another end")
    return rows


def _values(cells: list[str], place: Place) -> tuple[float, ...]:
    """Parse the numbers of a day; raises UserError."""
    if len(cells) < 9:
        place.refuse("year, month, day, MJD, x, y, UT1-UTC, dX and dY", f"{len(cells)} values")
    mjd = within(cells[3], place._replace(column="MJD"), 0.0, 1e5)
    if calendar_days(cells[:3], place) - MJD != mjd:
        place._replace(column="MJD").refuse(f"the modified Julian date of {'-'.join(cells[:3])}", cells[3])
    x, y = (within(cell, place._replace(column="pole"), -1000.0, 1000.0) for cell in cells[4:6])
    ut1 = within(cells[6], place._replace(column="UT1-UTC"), -900.0, 900.0)
    offsets = (within(cell, place._replace(column="dX, dY"), -10.0, 10.0) for cell in cells[7:9])
    return mjd, x, y, ut1, *offsets
