"""Readings that came last: one that comes late is put in its place, and the later ones are replayed."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import NamedTuple

from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.stream_controls import Held
from ahnn.estimation import EstimatorState, Innovation

TIME = attrgetter("time")


class KeptReading(NamedTuple):
    """A reading that counted, what it told, state and controls behind it, and whether the gate reopened."""

    time: float
    reading: Reading
    state: EstimatorState
    innovation: Innovation
    controls: Held
    opened: bool = False


class ReadingWindow(NamedTuple):
    """What may still be changed by a late reading.

    Attributes:
        anchor: the state before the first entry.
        since: time of the anchor.
        held: controls that hold from the anchor on.
        entries: in the order of their times.
    """

    anchor: EstimatorState
    since: float
    held: Held = ()
    entries: tuple[KeptReading, ...] = ()

    @property
    def state(self) -> EstimatorState:
        """The newest state."""
        return self.entries[-1].state if self.entries else self.anchor

    @property
    def time(self) -> float:
        """Time of the newest state."""
        return self.entries[-1].time if self.entries else self.since

    @property
    def controls(self) -> Held:
        """Controls that hold from the newest state on."""
        return self.entries[-1].controls if self.entries else self.held

    def before(self, time: float) -> ReadingWindow:
        """Return the window up to a time, readings of that time included."""
        return self._replace(entries=self.entries[: bisect_right(self.entries, time, key=TIME)])

    def holds(self, reading: Reading) -> bool:
        """Return whether the same reading is in it."""
        low, high = (side(self.entries, reading.time, key=TIME) for side in (bisect_left, bisect_right))
        return any(alike(one.reading, reading) for one in self.entries[low:high])

    def kept(self, span: float, most: int) -> ReadingWindow:
        """Return the window without what is older than a span of time, or beyond so many readings."""
        first = max(0, len(self.entries) - most)
        while first < len(self.entries) and self.entries[first].time < self.time - span:
            first += 1
        if first == 0:
            return self
        last = self.entries[first - 1]
        return ReadingWindow(last.state, last.time, last.controls, self.entries[first:])


def alike(one: Reading, other: Reading) -> bool:
    """Return whether two readings are of one sensor and the same numbers, NaN in the same places."""
    if (one.sensor, one.controls) != (other.sensor, other.controls):
        return False
    pairs = zip(one.values, other.values, strict=True)
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)
