"""Laser ranging pass: normal points and weather records with their times."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import date
from typing import NamedTuple

from ahnn.data.files import epochs
from ahnn.tracking.formats.gathered import UNKNOWN, between
from ahnn.tracking.formats.instants import day_moment
from ahnn.tracking.tracking_data import Event

DAY_PS = epochs.DAY * epochs.SECOND


class WeatherRecord(NamedTuple):
    """Weather at a station: moment, pressure in hPa, temperature in K, relative humidity from 0 to 1."""

    moment: int
    values: tuple[float, float, float]


class NormalPoint(NamedTuple):
    """Normal point: moment, range in km, station configuration, epoch event and line number."""

    moment: int
    range: float
    configuration: str
    event: Event
    row: int


@dataclass
class RangingSession:
    """Content of a pass while its records are read.

    Attributes:
        start, stop: time span of the points; stop is None if unspecified.
        last: moment of the last point, which determines the day of the next one.
    """

    start: int
    stop: int | None
    last: int
    wavelengths: dict[str, float] = field(default_factory=dict)
    weather: list[WeatherRecord] = field(default_factory=list)
    points: list[NormalPoint] = field(default_factory=list)


def moment_near(moment: int, seconds: str) -> int:
    """Return the moment at given seconds of day that is nearest to a reference moment.

    Args:
        moment: reference moment.
        seconds: seconds of day, exact to a picosecond; after midnight, some stations continue counting and
            others restart.
    """
    whole, _, fraction = seconds.partition(".")
    plain = whole.isdigit() and (fraction or "0").isdigit()
    parts = int(fraction[:12].ljust(12, "0")) if plain else 0
    of_day = int(whole) * epochs.SECOND + parts if plain else round(float(seconds) * epochs.SECOND)
    today = date(2000, 1, 1).toordinal() + moment // DAY_PS
    candidates = [day_moment(today + k) + of_day for k in (-4, -3, -2, -1, 0, 1)]
    return min(candidates, key=lambda one: abs(one - moment))


def weather_at(records: list[WeatherRecord], moments: list[int]) -> list[tuple[float, float, float]]:
    """Interpolate the weather linearly at given moments; outside the records the nearest one is used."""
    if not records:
        return [UNKNOWN] * len(moments)
    known = [one.moment for one in records]
    columns = [
        between(known, list(column), moments) for column in zip(*(one.values for one in records), strict=True)
    ]
    return list(zip(*columns, strict=True))
