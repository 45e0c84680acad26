"""Survey of tracking data before orbit determination: stations, passes, gaps and outliers."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.tracking_data import KINDS, Kind, TrackingData

PASS = 10.0
"""Multiple of the median step that separates two passes."""
LONGEST = 1200.0
"""Step in seconds that always separates two passes."""
FASTEST = 12.0
"""Speed in km/s that no Earth satellite reaches."""
STANDS_OUT = 15.0
"""Outlier criterion: ratio of a value's distance from its neighbours to the median distance of the pass."""
CLEARLY = 5.0
"""Outlier criterion: ratio of the distance from the neighbours to the disagreement among these."""
FEWEST = 7
"""Minimum number of measurements in a pass for outlier detection."""
MOST = 0.2
"""Fraction of outliers in a pass above which they are regarded as noise."""
AROUND: dict[Kind, Kind] = {"azimuth": "elevation", "right_ascension": "declination"}
"""Angles around an axis, each with the angle from the plane perpendicular to it."""
Array = NDArray[np.float64]


class SeriesSurvey(NamedTuple):
    """Measurements of one kind by one station.

    Attributes:
        station, kind: station and kind of the measurements.
        times: (n,) seconds since the epoch of the data.
        passes: number of segments between long gaps.
        gap: longest gap, in seconds.
        outliers: indices of outliers among the measurements.
        impossible: indices of ranges that change faster than a satellite moves.
        rows: (n,) line numbers of the measurements; 0 if unknown.
        values: (n,) measurements in km, km/s or rad.
    """

    station: str
    kind: Kind
    times: Array
    passes: int
    gap: float
    outliers: NDArray[np.int64]
    impossible: NDArray[np.int64]
    rows: NDArray[np.int64]
    values: Array


def survey(data: TrackingData) -> list[SeriesSurvey]:
    """Survey the measurements by station and kind."""
    found = []
    rows = np.zeros(len(data.times), dtype=np.int64) if data.rows is None else data.rows
    for k, name in enumerate(data.stations):
        for c, kind in enumerate(KINDS):
            chosen = np.flatnonzero((data.station == k) & np.isfinite(data.values[:, c]))
            if len(chosen):
                values, above = data.values[chosen, c], None
                if kind in AROUND:
                    above = data.values[chosen, KINDS.index(AROUND[kind])]
                found.append(of_series(name, kind, data.times[chosen], values, rows[chosen], above))
    return found


def of_series(
    station: str,
    kind: Kind,
    times: Array,
    values: Array,
    rows: NDArray[np.int64],
    above: Array | None = None,
) -> SeriesSurvey:
    """Survey one series, (n,) times in s, values in km, km/s or rad, and line numbers.

    Angles around an axis turn fast where the direction passes near it. With the angles `above` the plane,
    (n,), neighbours are directions, and errors are arcs on the sphere.
    """
    steps = np.diff(times)
    limit = min(LONGEST, PASS * float(np.median(steps))) if len(steps) else LONGEST
    bounds = [0, *(np.flatnonzero(steps > limit) + 1).tolist(), len(times)]
    apart, series = difference, (np.unwrap(values) if kind in AROUND else values)[:, None]
    if above is not None and np.isfinite(above).all():
        apart, series = arc, directions(values, above)
    outliers = [
        start + standing_out(times[start:stop], series[start:stop], apart)
        for start, stop in itertools.pairwise(bounds)
    ]
    impossible = np.zeros(0, dtype=np.int64)
    if kind == "range":
        impossible = np.flatnonzero(np.abs(np.diff(values)) > FASTEST * steps) + 1
    gap = float(steps.max()) if len(steps) else 0.0
    passes = len(bounds) - 1
    return SeriesSurvey(station, kind, times, passes, gap, np.concatenate(outliers), impossible, rows, values)


def directions(around: Array, above: Array) -> Array:
    """Return unit vectors (n, 3) in the directions of two angles."""
    level = np.cos(above)
    return np.stack((level * np.cos(around), level * np.sin(around), np.sin(above)), axis=1)


def difference(value: Array, other: Array) -> float:
    """Return the distance of two values of one component."""
    return float(abs(value[0] - other[0]))


def arc(value: Array, other: Array) -> float:
    """Return the chord between the meridians of two directions, at their height above the plane.

    It is largest for opposite directions, whose neighbours are then nearer to them.
    """
    half = (np.arctan2(value[1], value[0]) - np.arctan2(other[1], other[0])) / 2
    return float(2 * abs(np.sin(half)) * np.sqrt(np.hypot(*value[:2]) * np.hypot(*other[:2])))


def standing_out(times: Array, values: Array, apart: Callable[[Array, Array], float]) -> NDArray[np.int64]:
    """Return the indices of outliers in one pass, found one after another.

    Values are compared with polynomials through six and through four neighbours. If these differ, the
    measurements are too sparse for a decision. The largest outlier is removed before the search for the next
    one, since it also affects its neighbours.
    """
    kept, found = np.arange(len(times)), list[int]()
    while len(kept) >= FEWEST:
        errors, doubts = from_neighbours(times[kept], values[kept], apart)
        around = np.max([doubts[:-2], doubts[1:-1], doubts[2:]], axis=0)  # a single one may be 0 by chance
        judged = np.where(errors[1:-1] > CLEARLY * around, errors[1:-1], 0.0)
        worst = int(np.argmax(judged)) + 1
        if judged[worst - 1] <= STANDS_OUT * float(np.median(errors)):
            break
        found.append(int(kept[worst]))
        kept = np.delete(kept, worst)
    return np.array(sorted(found) if len(found) <= MOST * len(times) else [], dtype=np.int64)


def from_neighbours(
    times: Array, values: Array, apart: Callable[[Array, Array], float]
) -> tuple[Array, Array]:
    """Return distances of values from six-neighbour polynomials, and of these from four-neighbour ones.

    Both are (n,), normalised such that unit noise of the values gives unit noise of the first distance.

    Args:
        times: (n,) non-decreasing times, n at least 7; results are zero for equal times and at both ends.
        values: (n, C).
        apart: distance of two values (C,).
    """
    errors, doubts = np.zeros(len(times)), np.zeros(len(times))
    for k in range(1, len(times) - 1):
        six, four = (interpolation(times, k, count) for count in (6, 4))
        if six is not None and four is not None:
            scale = np.sqrt(1 + six[1] @ six[1])
            said = six[1] @ values[six[0]]
            errors[k] = apart(values[k], said) / scale
            doubts[k] = apart(said, four[1] @ values[four[0]]) / scale
    return errors, doubts


def interpolation(times: Array, k: int, count: int) -> tuple[NDArray[np.int64], Array] | None:
    """Return indices and weights of the nearest neighbours of a time; None for equal times."""
    start = min(max(k - count // 2, 0), len(times) - count - 1)
    others = np.delete(np.arange(start, start + count + 1), k - start)
    apart = times[others, None] - times[others] + np.eye(count)
    if (apart == 0).any():
        return None
    away = np.where(np.eye(count, dtype=bool), 1.0, times[k] - times[others])
    return others, np.prod(away / apart, axis=1)
