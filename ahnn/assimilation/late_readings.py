"""Window of recent readings: late readings are inserted at their times, and later ones replayed."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import NamedTuple

from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.stream_controls import Held
from ahnn.estimation import EstimatorState, Innovation
from ahnn.estimation.process_model import StepLaw

TIME = attrgetter("time")


class KeptReading(NamedTuple):
    """Processed reading, the state, innovation and controls after it, and the laws of the steps before it.

    `opened` marks a reading that reopened the gate.
    """

    time: float
    reading: Reading
    state: EstimatorState
    innovation: Innovation
    controls: Held
    opened: bool = False
    laws: tuple[StepLaw, ...] = ()


class ReadingWindow(NamedTuple):
    """Readings that a late reading may still affect.

    Attributes:
        anchor: state before the first entry.
        since: time of the anchor.
        held: controls valid from the time of the anchor.
        entries: kept readings in order of time.
    """

    anchor: EstimatorState
    since: float
    held: Held = ()
    entries: tuple[KeptReading, ...] = ()

    @property
    def state(self) -> EstimatorState:
        """Newest state."""
        return self.entries[-1].state if self.entries else self.anchor

    @property
    def time(self) -> float:
        """Time of the newest state."""
        return self.entries[-1].time if self.entries else self.since

    @property
    def controls(self) -> Held:
        """Controls valid from the time of the newest state."""
        return self.entries[-1].controls if self.entries else self.held

    def before(self, time: float) -> ReadingWindow:
        """Return the window up to and including a time."""
        return self._replace(entries=self.entries[: bisect_right(self.entries, time, key=TIME)])

    def holds(self, reading: Reading) -> bool:
        """Return whether the window contains an equal reading."""
        low, high = (side(self.entries, reading.time, key=TIME) for side in (bisect_left, bisect_right))
        return any(alike(one.reading, reading) for one in self.entries[low:high])

    def kept(self, span: float, most: int) -> ReadingWindow:
        """Return the window limited to a time span and a number of readings."""
        first = max(len(self.entries) - most, bisect_left(self.entries, self.time - span, key=TIME))
        if first == 0:
            return self
        last = self.entries[first - 1]
        return ReadingWindow(last.state, last.time, last.controls, self.entries[first:])


def alike(one: Reading, other: Reading) -> bool:
    """Return whether two readings have the same sensor and equal values, including NaN positions."""
    if (one.sensor, one.controls) != (other.sensor, other.controls):
        return False
    pairs = zip(one.values, other.values, strict=True)
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)
