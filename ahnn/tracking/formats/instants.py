"""Conversion of epochs in any time scale to UTC with leap seconds, in integer picoseconds."""

from __future__ import annotations

from datetime import date

from ahnn.data.files import epochs
from ahnn.data.files.frames import TO_TT
from ahnn.data.files.table import Place

CLOCKS = ("UTC", "TAI", "GPS", "TT")
MJD = date(1858, 11, 17).toordinal()
"""Ordinal of day 0 of the modified Julian date."""


def utc_moment(text: str, place: Place, clock: str = "UTC") -> int:
    """Return an epoch as picoseconds since 2000-01-01 in UTC with all leap seconds (`epochs.instant`).

    Raises:
        UserError: an invalid epoch, or one outside 1972 to 2200: earlier, UTC differs from TAI by fractional
            seconds; later, no tracking data exist.
    """
    try:
        moment = epochs.instant(text, utc=clock == "UTC")
    except ValueError as error:
        place.refuse(str(error), repr(text))
    if not FIRST <= moment < LAST:
        place.refuse("an epoch from 1972 to 2200", repr(text))
    return moment + round(1000 * (TO_TT[clock] - TO_TT["UTC"])) * (epochs.SECOND // 1000)


def day_moment(days: int) -> int:
    """Return the first instant of a day, in UTC.

    Args:
        days: proleptic ordinal of the date.
    """
    return epochs.instant(date.fromordinal(days).isoformat(), utc=True)


def calendar_days(cells: list[str], place: Place) -> int:
    """Return the ordinal of year, month and day from 1972 to 2200; raises UserError."""
    try:
        year, month, day = map(int, cells)
        found = date(year, month, day)
    except (ValueError, OverflowError):
        place.refuse("year, month and day", repr(" ".join(cells)))
    if not 1972 <= year < 2200:
        place.refuse("a year from 1972 to 2200", repr(cells[0]))
    return found.toordinal()


FIRST = day_moment(date(1972, 1, 1).toordinal())
LAST = day_moment(date(2200, 1, 1).toordinal())
