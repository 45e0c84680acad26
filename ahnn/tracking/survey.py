"""Survey of tracking data before orbit determination: stations, passes, gaps and outliers."""

from __future__ import annotations

import itertools
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
UNWRAPPED = ("azimuth", "right_ascension")


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
    """

    station: str
    kind: Kind
    times: NDArray[np.float64]
    passes: int
    gap: float
    outliers: NDArray[np.int64]
    impossible: NDArray[np.int64]
    rows: NDArray[np.int64]


def survey(data: TrackingData) -> list[SeriesSurvey]:
    """Survey the measurements by station and kind."""
    found = []
    rows = np.zeros(len(data.times), dtype=np.int64) if data.rows is None else data.rows
    for k, name in enumerate(data.stations):
        for c, kind in enumerate(KINDS):
            chosen = np.flatnonzero((data.station == k) & np.isfinite(data.values[:, c]))
            if len(chosen):
                found.append(of_series(name, kind, data.times[chosen], data.values[chosen, c], rows[chosen]))
    return found


def of_series(
    station: str,
    kind: Kind,
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    rows: NDArray[np.int64],
) -> SeriesSurvey:
    """Survey one series, (n,) times in s, values in km, km/s or rad, and line numbers."""
    steps = np.diff(times)
    limit = min(LONGEST, PASS * float(np.median(steps))) if len(steps) else LONGEST
    bounds = [0, *(np.flatnonzero(steps > limit) + 1).tolist(), len(times)]
    plain = np.unwrap(values) if kind in UNWRAPPED else values
    outliers = [
        start + standing_out(times[start:stop], plain[start:stop])
        for start, stop in itertools.pairwise(bounds)
    ]
    impossible = np.zeros(0, dtype=np.int64)
    if kind == "range":
        impossible = np.flatnonzero(np.abs(np.diff(values)) > FASTEST * steps) + 1
    gap = float(steps.max()) if len(steps) else 0.0
    passes = len(bounds) - 1
    return SeriesSurvey(station, kind, times, passes, gap, np.concatenate(outliers), impossible, rows)


def standing_out(times: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices of outliers in one pass, found one after another.

    Values are compared with polynomials through six and through four neighbours. If these differ, the
    measurements are too sparse for a decision. The largest outlier is removed before the search for the next
    one, since it also affects its neighbours.
    """
    kept, found = np.arange(len(times)), list[int]()
    while len(kept) >= FEWEST:
        errors, doubts = from_neighbours(times[kept], values[kept])
        around = np.max([doubts[:-2], doubts[1:-1], doubts[2:]], axis=0)  # a single one may be 0 by chance
        judged = np.where(errors[1:-1] > CLEARLY * around, errors[1:-1], 0.0)
        worst = int(np.argmax(judged)) + 1
        if judged[worst - 1] <= STANDS_OUT * float(np.median(errors)):
            break
        found.append(int(kept[worst]))
        kept = np.delete(kept, worst)
    return np.array(sorted(found) if len(found) <= MOST * len(times) else [], dtype=np.int64)


def from_neighbours(
    times: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances of values from six-neighbour polynomials, and of these from four-neighbour ones.

    Both are (n,), normalised such that unit noise of the values gives unit noise of the first distance.

    Args:
        times: (n,) non-decreasing times, n at least 7; results are zero for equal times and at both ends.
        values: (n,).
    """
    errors, doubts = np.zeros(len(times)), np.zeros(len(times))
    for k in range(1, len(times) - 1):
        six, four = (interpolation(times, k, count) for count in (6, 4))
        if six is not None and four is not None:
            scale = np.sqrt(1 + six[1] @ six[1])
            said = six[1] @ values[six[0]]
            errors[k] = abs(values[k] - said) / scale
            doubts[k] = abs(said - four[1] @ values[four[0]]) / scale
    return errors, doubts


def interpolation(
    times: NDArray[np.float64], k: int, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Return indices and weights of the nearest neighbours of a time; None for equal times."""
    start = min(max(k - count // 2, 0), len(times) - count - 1)
    others = np.delete(np.arange(start, start + count + 1), k - start)
    apart = times[others, None] - times[others] + np.eye(count)
    if (apart == 0).any():
        return None
    away = np.where(np.eye(count, dtype=bool), 1.0, times[k] - times[others])
    return others, np.prod(away / apart, axis=1)
