"""Tracked objects: windows of recent readings and row allocation of beliefs."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import torch

from ahnn.assimilation.reading_table import Array, Places
from ahnn.estimation import Belief, FilterState
from ahnn.estimation.member_steps import empty_rows, member_rows, put_rows

TIME = attrgetter("time")


class KeptRow(NamedTuple):
    """Reading of one object with the row of its posterior belief.

    Attributes:
        time: time of the reading.
        slot: index of the belief's row.
        sensor: sensor index.
        values: W values; None for the initial belief.
        deviations: W standard deviations.
    """

    time: float
    slot: int
    sensor: int = -1
    values: list[float] | None = None
    deviations: list[float] | None = None

    def alike(self, sensor: int, values: list[float]) -> bool:
        """Return whether readings are equal, including NaN positions."""
        if self.values is None or self.sensor != sensor:
            return False
        pairs = zip(self.values, values, strict=True)
        return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


class ObjectWindow(list[KeptRow]):
    """Readings of one object in chronological order, preceded by the belief before the first of them.

    Without replay it contains only the readings at the newest time, which share one row.
    """

    def place(self, time: float) -> int:
        """Return the insertion index of a reading, after readings of the same time."""
        return bisect_right(self, time, key=TIME)

    def holds(self, time: float, sensor: int, values: list[float]) -> bool:
        """Return whether the window contains an equal reading."""
        return any(one.time == time and one.alike(sensor, values) for one in self)

    def renew(self, entry: KeptRow, most: int) -> None:
        """Add the newest reading without replay; keep a limited number of readings of the same time."""
        if self[-1].time < entry.time:
            self.clear()
        self.append(entry)
        del self[: max(0, len(self) - most)]

    def forget(self, span: float, most: int) -> list[int]:
        """Drop readings beyond a time span or a number; return their rows."""
        first, oldest = max(0, len(self) - 1 - most), self[-1].time - span
        while first < len(self) - 1 and self[first + 1].time < oldest:
            first += 1
        if not first:
            return []
        freed = [one.slot for one in self[:first]]
        self[: first + 1] = [KeptRow(self[first].time, self[first].slot)]
        return freed


class FollowedObjects:
    """Beliefs about objects, stored in rows of one state.

    Args:
        like: a state of the filter as template.

    Attributes:
        state: state of all rows, including free ones.
        names: names of the N objects with their indices.
        windows: reading window of each object.
        times: (N,) times of the newest beliefs.
        since: (N,) times before which nothing is replayed.
        newest: (N,) row indices of the newest beliefs.
        lost: (N,) statuses of failed filters, 0 for all other filters.
    """

    def __init__(self, like: FilterState) -> None:
        self.state, self._used = empty_rows(like, 0), 0
        self._free: list[int] = []
        self.names: dict[str, int] = {}
        self.windows: list[ObjectWindow] = []
        self.times, self.since = np.zeros(0), np.zeros(0)
        self.newest, self.lost = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def enrol(self, names: Sequence[str], state: FilterState, times: Array) -> None:
        """Add objects with individual initial states, or a common one, at times (N,)."""
        slots, first = self.take(len(names)), len(self.names)
        put_rows(self.state, torch.from_numpy(slots), state)
        self.names |= {name: first + k for k, name in enumerate(names)}
        pairs = zip(times.tolist(), slots.tolist(), strict=True)
        self.windows += [ObjectWindow([KeptRow(time, slot)]) for time, slot in pairs]
        self.times, self.since = np.append(self.times, times), np.append(self.since, times)
        self.newest = np.append(self.newest, slots)
        self.lost = np.append(self.lost, np.zeros_like(slots))

    def take(self, count: int) -> Places:
        """Allocate free rows and return their indices."""
        kept = max(0, len(self._free) - count)
        again, self._free = self._free[kept:], self._free[:kept]
        begin, self._used = self._used, self._used + count - len(again)
        if self._used > (room := len(self.state.status)):
            whole = empty_rows(self.state, max(self._used, 2 * room))
            put_rows(whole, torch.arange(room), self.state)
            self.state = whole
        return np.array([*again, *range(begin, self._used)], dtype=np.int64)

    def release(self, slots: Sequence[int]) -> None:
        """Mark rows as free."""
        self._free += slots

    def write(self, slots: Places, state: FilterState) -> None:
        """Write a state into rows."""
        put_rows(self.state, torch.from_numpy(slots), state)

    def beliefs(self, numbers: Places, size: int) -> Belief:
        """Return the newest beliefs of objects, restricted to the leading components."""
        return member_rows(self.state, torch.from_numpy(self.newest[numbers])).leading(size).moments

    def restore(
        self, names: list[str], state: FilterState, windows: list[ObjectWindow], since: Array, lost: Places
    ) -> None:
        """Take over the content of another container that has no free rows."""
        self.state, self._used, self._free = state, len(state.status), []
        self.names = {name: k for k, name in enumerate(names)}
        self.windows, self.since, self.lost = windows, since, lost
        self.times = np.array([window[-1].time for window in windows], dtype=np.float64)
        self.newest = np.array([window[-1].slot for window in windows], dtype=np.int64)
