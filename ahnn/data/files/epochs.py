"""Calendar epochs as integer picoseconds, without loss of digits and with UTC leap seconds.

The formats follow CCSDS 301.0 (ASCII time codes A and B).
"""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, timedelta

SECOND = 10**12
"""Picoseconds per second."""
DAY = 86400
FIRST = date(2000, 1, 1).toordinal()
CODE = re.compile(
    r"(?P<year>\d{4})([-/](?P<month>\d\d)[-/](?P<day>\d\d)|-(?P<number>\d{3}))"
    r"([T ](?P<hour>\d\d):(?P<minute>\d\d)(:(?P<second>\d\d)(\.(?P<fraction>\d{0,12})\d*)?)?)?"
    r" ?(?P<zone>Z|(?P<sign>[+-])(?P<ahead>\d\d):?(?P<rest>\d\d)?)?",
    re.ASCII,
)
DATE = re.compile(
    r"\s*(\d+\s*[-/.]\s*(\d+|[A-Za-z]{3,9})\s*[-/.]\s*\d+|\d+:\d\d|\d{8}T\d"
    r"|[A-Za-z]{3,9},?\s+\d|\d+\s+[A-Za-z]{3})"
)
"""Patterns of the beginning of dates and times of day, in any notation."""
EXPECTED = "an epoch such as 2024-03-01T12:00:00.125, 2024-061T12:00:00 or 2024-03-01T14:00:00+02:00"
LEAPS = tuple(
    date(year, month, 1).toordinal() - FIRST
    for month, years in (
        (1, (1973, 1974, 1975, 1976, 1977, 1978, 1979, 1980, 1988, 1990, 1991, 1996, 1999, 2006, 2009, 2017)),
        (7, (1972, 1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)),
    )
    for year in years
)
"""Days since 2000-01-01 that follow a leap second (IERS Bulletin C; the last one was in 2016)."""


def instant(text: str, *, utc: bool) -> int:
    """Parse an epoch to picoseconds since the beginning of 2000.

    Args:
        text: text such as 2024-03-01T12:00:00.125 or 2024-061T12:00:00, optionally with a blank instead of T,
            without seconds or without a time (midnight), and in UTC with an offset such as +02:00.
        utc: whether the time scale is UTC, with leap seconds between epochs.

    Raises:
        ValueError: unknown format, invalid date, or an offset in another time scale.
    """
    found = CODE.fullmatch(text.strip())
    if found is None:
        raise ValueError(EXPECTED)
    days = _days(found) - FIRST
    hour, minute, second = (int(found[name] or 0) for name in ("hour", "minute", "second"))
    behind = _offset(found, utc=utc)
    leap = second == 60 and utc and _ends_with_leap(days, 60 * hour + minute - behind)
    if hour > 23 or minute > 59 or (second > 59 and not leap):
        message = "a time of day"
        raise ValueError(message)
    minutes = 1440 * days + 60 * hour + minute - behind
    seconds = 60 * minutes + second + (leaps(minutes // 1440) if utc else 0)
    return seconds * SECOND + int((found["fraction"] or "").ljust(12, "0"))


def _offset(found: re.Match[str], *, utc: bool) -> int:
    """Return the UTC offset of a local time in minutes."""
    if found["sign"] is None:
        return 0
    ahead, rest = int(found["ahead"]), int(found["rest"] or 0)
    if ahead > 15 or rest > 59 or found["hour"] is None:
        message = "a UTC offset such as +02:00 after a time"
        raise ValueError(message)
    if (ahead or rest) and not utc:
        message = "an epoch without an offset, since its time scale is not UTC"
        raise ValueError(message)
    return (60 * ahead + rest) * (-1 if found["sign"] == "-" else 1)


def _ends_with_leap(days: int, minute: int) -> bool:
    """Return whether a UTC minute of a day contains a leap second."""
    return minute % 1440 == 1439 and days + minute // 1440 + 1 in LEAPS


def _days(found: re.Match[str]) -> int:
    """Return the ordinal of a date given by month and day, or by day of year."""
    try:
        if found["number"] is None:
            return date(int(found["year"]), int(found["month"]), int(found["day"])).toordinal()
        day = date(int(found["year"]), 1, 1) + timedelta(days=int(found["number"]) - 1)
    except ValueError as error:
        message = "a calendar date"
        raise ValueError(message) from error
    if day.year != int(found["year"]):
        message = "a calendar date"
        raise ValueError(message)
    return day.toordinal()


def leaps(days: int) -> int:
    """Return the number of leap seconds before a day."""
    return sum(leap <= days for leap in LEAPS)


def day_and_time(moment: int, *, utc: bool) -> tuple[int, int]:
    """Return the day of an epoch since 2000-01-01, and the picoseconds since midnight."""
    seconds, fraction = divmod(moment, SECOND)
    days = (seconds - leaps(seconds // DAY)) // DAY if utc else seconds // DAY
    return days, (seconds - days * DAY - (leaps(days) if utc else 0)) * SECOND + fraction


def spelled(moment: int, *, utc: bool) -> str:
    """Format an epoch for `instant`, with at least three decimals."""
    days, of_day = day_and_time(moment, utc=utc)
    of_day, fraction = divmod(of_day, SECOND)
    extra = max(0, of_day - DAY + 1)  # 23:59:60
    hour, rest = divmod(of_day - extra, 3600)
    clock = f"{hour:02}:{rest // 60:02}:{rest % 60 + extra:02}"
    decimals = f"{fraction:012}".rstrip("0").ljust(3, "0")
    return f"{date.fromordinal(FIRST + days).isoformat()}T{clock}.{decimals}"


def now() -> str:
    """Return the current system time as an epoch in UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
