"""Objects that are followed: what each keeps of its newest readings, and in which row its beliefs are."""

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
    """A reading of one object, and the row of the belief after it.

    Attributes:
        time: of the reading.
        slot: number of the row.
        sensor: its number.
        values: W numbers; None of the belief before all others.
        deviations: W numbers.
    """

    time: float
    slot: int
    sensor: int = -1
    values: list[float] | None = None
    deviations: list[float] | None = None

    def alike(self, sensor: int, values: list[float]) -> bool:
        """Return whether it is the same reading, NaN in the same places."""
        if self.values is None or self.sensor != sensor:
            return False
        pairs = zip(self.values, values, strict=True)
        return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


class ObjectWindow(list[KeptRow]):
    """Readings of one object in the order of their times, behind the belief from before them.

    Where nothing is ever replayed these are readings of the newest time alone, and share one row.
    """

    def place(self, time: float) -> int:
        """Return where a reading of a time goes: behind those of the same time."""
        return bisect_right(self, time, key=TIME)

    def holds(self, time: float, sensor: int, values: list[float]) -> bool:
        """Return whether the same reading is in it."""
        return any(one.time == time and one.alike(sensor, values) for one in self)

    def renew(self, entry: KeptRow, most: int) -> None:
        """Add the newest reading where nothing is replayed: others of its time are kept, so many at most."""
        if self[-1].time < entry.time:
            self.clear()
        self.append(entry)
        del self[: max(0, len(self) - most)]

    def forget(self, span: float, most: int) -> list[int]:
        """Drop what is older than a span of time or beyond so many readings; return the rows of these."""
        first, oldest = max(0, len(self) - 1 - most), self[-1].time - span
        while first < len(self) - 1 and self[first + 1].time < oldest:
            first += 1
        if not first:
            return []
        freed = [one.slot for one in self[:first]]
        self[: first + 1] = [KeptRow(self[first].time, self[first].slot)]
        return freed


class FollowedObjects:
    """Beliefs about objects in the rows of one state.

    Args:
        like: a state of the filter.

    Attributes:
        state: of all rows, some of which are free.
        names: of the N objects, with their numbers.
        windows: of each.
        times: (N,) of the newest belief of each.
        since: (N,) before which nothing of an object is replayed.
        newest: (N,) rows of the newest beliefs.
        lost: (N,) statuses of filters that have ended, 0 of others.
    """

    def __init__(self, like: FilterState) -> None:
        self.state, self._used = empty_rows(like, 0), 0
        self._free: list[int] = []
        self.names: dict[str, int] = {}
        self.windows: list[ObjectWindow] = []
        self.times, self.since = np.zeros(0), np.zeros(0)
        self.newest, self.lost = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def enrol(self, names: Sequence[str], state: FilterState, times: Array) -> None:
        """Add objects that begin with a state each, or all with that of one, at times (N,)."""
        slots, first = self.take(len(names)), len(self.names)
        put_rows(self.state, torch.from_numpy(slots), state)
        self.names |= {name: first + k for k, name in enumerate(names)}
        pairs = zip(times.tolist(), slots.tolist(), strict=True)
        self.windows += [ObjectWindow([KeptRow(time, slot)]) for time, slot in pairs]
        self.times, self.since = np.append(self.times, times), np.append(self.since, times)
        self.newest = np.append(self.newest, slots)
        self.lost = np.append(self.lost, np.zeros_like(slots))

    def take(self, count: int) -> Places:
        """Return the numbers of so many free rows."""
        kept = max(0, len(self._free) - count)
        again, self._free = self._free[kept:], self._free[:kept]
        begin, self._used = self._used, self._used + count - len(again)
        if self._used > (room := len(self.state.status)):
            whole = empty_rows(self.state, max(self._used, 2 * room))
            put_rows(whole, torch.arange(room), self.state)
            self.state = whole
        return np.array([*again, *range(begin, self._used)], dtype=np.int64)

    def release(self, slots: Sequence[int]) -> None:
        """Give rows back."""
        self._free += slots

    def write(self, slots: Places, state: FilterState) -> None:
        """Write a state into rows."""
        put_rows(self.state, torch.from_numpy(slots), state)

    def beliefs(self, numbers: Places, size: int) -> Belief:
        """Return the newest beliefs about the first components of some objects."""
        return member_rows(self.state, torch.from_numpy(self.newest[numbers])).leading(size).moments

    def restore(
        self, names: list[str], state: FilterState, windows: list[ObjectWindow], since: Array, lost: Places
    ) -> None:
        """Take over what another has kept, all its rows in use."""
        self.state, self._used, self._free = state, len(state.status), []
        self.names = {name: k for k, name in enumerate(names)}
        self.windows, self.since, self.lost = windows, since, lost
        self.times = np.array([window[-1].time for window in windows], dtype=np.float64)
        self.newest = np.array([window[-1].slot for window in windows], dtype=np.int64)
