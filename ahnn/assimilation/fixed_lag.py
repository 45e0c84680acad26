"""Fixed-lag smoothing: the belief about an earlier time, given all later readings.

The Rauch-Tung-Striebel smoother propagates the newest estimate back through the steps of the filter. The
result is the belief given all readings so far, at the time of one of them.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

from torch import Tensor

from ahnn.assimilation.late_readings import TIME, ReadingWindow
from ahnn.estimation import Belief
from ahnn.estimation.smoother import stepped_back


class LaggedEstimate(NamedTuple):
    """A time and the belief about the state at that time, for one member."""

    time: float
    belief: Belief


def smoothed_at(window: ReadingWindow, time: float) -> LaggedEstimate | None:
    """Return the smoothed belief after the last reading that is not later than a time.

    Returns None if the time precedes the window, or a reading that reopened the gate: an enlarged covariance
    cannot be smoothed backwards.
    """
    first = bisect_right(window.entries, time, key=TIME)
    later = window.entries[first:]
    if (first == 0 and window.since > time) or any(entry.opened for entry in later):
        return None
    belief = window.state.moments
    for entry in reversed(later):
        for law in reversed(entry.laws):
            belief = stepped_back(law.before, law.predicted, law.backward, belief)
    return LaggedEstimate(window.before(time).time, belief)


def numbers_of(found: LaggedEstimate | None, scales: Tensor) -> list[float]:
    """Return the time, and mean and standard deviations divided by scales; NaN without an estimate."""
    size = len(scales)
    if found is None:
        return [float("nan")] * (1 + 2 * size)
    mean, chol = found.belief
    deviations: Tensor = chol[0, :size].norm(dim=-1)
    return [found.time, *(mean[0, :size] / scales).tolist(), *(deviations / scales).tolist()]
