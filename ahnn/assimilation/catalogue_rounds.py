"""Rounds of a catalogue: at most one reading per object, inserted at its time, with replay of later ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from ahnn.assimilation.member_updates import FAULT, MeasuredRows, MemberOutcome, MemberUpdates
from ahnn.assimilation.object_windows import FollowedObjects, KeptRow
from ahnn.assimilation.online import absurd_numbers, lost_filter
from ahnn.assimilation.reading_table import FATES, Array, CatalogueEstimates, Places, ReadingTable
from ahnn.estimation.member_steps import member_rows

TAKEN, REOPENED, REJECTED, PREDICTED, REPEATED, LATE, AHEAD, BAD, GONE = range(len(FATES) - 1)


class Limits(NamedTuple):
    """Limits on the delay of readings, on the number kept for replay, and on their time ahead."""

    window: float
    lines: int
    gap: float


class Candidates(NamedTuple):
    """Readings of B objects to be filtered.

    Attributes:
        rows: (B,) rows in the table.
        numbers: (B,) indices of the objects.
        slots: (B,) rows of the preceding beliefs.
        since: (B,) times of these beliefs.
        later: readings of the object after the candidate, by candidate index.
    """

    rows: Places
    numbers: Places
    slots: Places
    since: Array
    later: dict[int, list[KeptRow]]


class CatalogueRounds:
    """Processing of readings of tracked objects in rounds.

    Args:
        objects: tracked objects.
        updates: filters of the objects.
        limits: limits on their readings.
    """

    def __init__(self, objects: FollowedObjects, updates: MemberUpdates, limits: Limits) -> None:
        self.objects, self.updates, self.limits = objects, updates, limits

    def take(self, rows: Places, numbers: Places, readings: ReadingTable, found: CatalogueEstimates) -> None:
        """Process one reading for each of some objects, and record its outcome.

        Args:
            rows: (B,) rows of the readings.
            numbers: (B,) distinct indices of their objects.
            readings: table that contains the rows.
            found: estimates to fill.
        """
        fates = self._refused(readings.times[rows], numbers)
        candidates = self._candidates(rows, numbers, readings, fates)
        if len(candidates.rows):
            self._filter(candidates, readings, found)
        refused = fates >= 0
        found.fates[rows[refused]] = fates[refused]
        found.times[rows] = self.objects.times[numbers]
        belief, place = self.objects.beliefs(numbers, found.means.shape[-1]), torch.from_numpy(rows)
        found.means[place], found.covariances[place] = belief.mean, belief.covariance

    def _refused(self, times: Array, numbers: Places) -> Places:
        """Return the fates of readings that are too late, too far ahead or of lost objects, else -1."""
        now, fates = self.objects.times[numbers], np.full(len(times), -1)
        fates[times < np.maximum(now - self.limits.window, self.objects.since[numbers])] = LATE
        fates[times > now + self.limits.gap] = AHEAD
        fates[self.objects.lost[numbers] != 0] = GONE
        return fates

    def _candidates(self, rows: Places, numbers: Places, readings: ReadingTable, fates: Places) -> Candidates:
        """Return the readings to be filtered; record duplicates in `fates`."""
        objects, times = self.objects, readings.times[rows]
        slots, since, later = objects.newest[numbers], objects.times[numbers], dict[int, list[KeptRow]]()
        for k in np.flatnonzero((fates < 0) & (times <= since)).tolist():
            window, row = objects.windows[numbers[k]], rows[k]
            if window.holds(times[k], int(readings.sensors[row]), readings.values[row].tolist()):
                fates[k] = REPEATED
            elif (place := window.place(times[k])) < len(window):
                later[k] = window[place:]
                slots[k], since[k] = window[place - 1].slot, window[place - 1].time
        chosen = np.flatnonzero(fates < 0)
        if later:
            place_of = {k: j for j, k in enumerate(chosen.tolist())}
            later = {place_of[k]: entries for k, entries in later.items()}
        return Candidates(rows[chosen], numbers[chosen], slots[chosen], since[chosen], later)

    def _filter(self, chosen: Candidates, readings: ReadingTable, found: CatalogueEstimates) -> None:
        """Filter readings, replay later ones, keep valid results, and record the innovations."""
        _, times, sensors, values, deviations = readings
        given = MeasuredRows(times, sensors, values, deviations).at(chosen.rows)
        outcome, targets = self._step(chosen.numbers, chosen.slots, chosen.since, given)
        statuses = outcome.statuses.numpy()
        chains = {j: [_kept(given, j, int(targets[j]))] for j in chosen.later if not statuses[j]}
        faults = {j: _kept(given, j, -1) for j in np.flatnonzero(statuses).tolist()}
        self._replay(chosen, chains, statuses, faults)
        for j, by in faults.items():
            self._fail(int(chosen.rows[j]), int(chosen.numbers[j]), int(statuses[j]), by, found)
        sound = np.flatnonzero(statuses == 0)
        self._keep(chosen, given, targets, sound, chains)
        place, own = chosen.rows[sound], torch.from_numpy(sound)
        empty = np.isnan(given.values[sound]).all(1)
        fates = np.where(outcome.rejected.numpy()[sound], REJECTED, np.where(empty, PREDICTED, TAKEN))
        found.fates[place] = np.where(outcome.reopened.numpy()[sound], REOPENED, fates)
        into = found.residuals, found.deviations, found.nis, found.measured
        for whole, part in zip(into, outcome[4:], strict=True):
            whole[torch.from_numpy(place)] = part[own]
        for j in chains:
            found.replayed[chosen.rows[j]] = len(chosen.later[j])

    def _step(
        self, numbers: Places, slots: Places, since: Array, given: MeasuredRows
    ) -> tuple[MemberOutcome, Places]:
        """Filter readings; return the innovations, and the rows of posterior beliefs for valid members."""
        objects = self.objects
        outcome = self.updates.filtered(objects.state, numbers, slots, since, given)
        sound = outcome.statuses.numpy() == 0
        targets = objects.take(len(slots)) if self.limits.window else slots
        if sound.all():
            objects.write(targets, outcome.state)
        else:
            objects.write(targets[sound], member_rows(outcome.state, torch.from_numpy(sound)))
            if self.limits.window:
                objects.release(targets[~sound].tolist())
        return outcome, targets

    def _replay(
        self,
        chosen: Candidates,
        chains: dict[int, list[KeptRow]],
        statuses: Places,
        faults: dict[int, KeptRow],
    ) -> None:
        """Replay later readings, one per object at a time; failed members release their rows."""
        wave, later = 0, chosen.later
        while live := [j for j in chains if wave < len(later[j])]:
            again, last = [later[j][wave] for j in live], [chains[j][-1] for j in live]
            slots, since = np.array([one.slot for one in last]), np.array([one.time for one in last])
            outcome, targets = self._step(chosen.numbers[live], slots, since, _rows_of(again))
            for k, j in enumerate(live):
                if status := int(outcome.statuses[k]):
                    statuses[j], faults[j] = status, again[k]
                    self.objects.release([one.slot for one in chains.pop(j)])
                else:
                    chains[j].append(again[k]._replace(slot=int(targets[k])))
            wave += 1

    def _keep(
        self,
        chosen: Candidates,
        given: MeasuredRows,
        targets: Places,
        sound: Places,
        chains: dict[int, list[KeptRow]],
    ) -> None:
        """Insert valid readings and the replayed later ones into the windows of their objects."""
        objects, (window, lines, _) = self.objects, self.limits
        numbers = chosen.numbers[sound]
        plain = np.setdiff1d(sound, [*chains]).astype(np.int64) if chains else sound
        own, fresh = chosen.numbers[plain], given.at(plain)
        columns = fresh.times, targets[plain], *fresh[1:]
        new = map(KeptRow, *(column.tolist() for column in columns))
        objects.times[own], objects.newest[own] = fresh.times, targets[plain]
        if not window:
            for number, entry in zip(own.tolist(), new, strict=True):
                objects.windows[number].renew(entry, lines)
            return
        for number, entry in zip(own.tolist(), new, strict=True):
            objects.windows[number].append(entry)
        for j, chain in chains.items():
            number, replaced = int(chosen.numbers[j]), chosen.later[j]
            kept = objects.windows[number]
            kept[len(kept) - len(replaced) :] = chain
            objects.release([one.slot for one in replaced])
            objects.newest[number] = chain[-1].slot
        for number in numbers.tolist():
            kept = objects.windows[number]
            freed = kept.forget(window, lines)
            if freed:
                objects.release(freed)
                objects.since[number] = kept[0].time

    def _fail(self, row: int, number: int, status: int, by: KeptRow, found: CatalogueEstimates) -> None:
        """Record why a reading is ignored; mark failed filters as lost."""
        updates = self.updates
        name = updates.names[by.sensor] if by.sensor >= 0 else ""
        if status != FAULT:
            self.objects.lost[number] = status
            found.fates[row], found.reasons[row] = GONE, lost_filter(status, by.time, name)
            return
        columns, own = updates.models.sensors[name].columns, updates.places[by.sensor].tolist()
        values, deviations = by.values or [], by.deviations or []
        said = [f"{column} {values[k]:g}" for column, k in zip(columns, own, strict=True)]
        sds = [deviations[k] for k in own if deviations[k] == deviations[k]]
        found.fates[row], found.reasons[row] = BAD, absurd_numbers(said, sds)


def _kept(given: MeasuredRows, j: int, slot: int) -> KeptRow:
    """Return one reading in the form kept in a window."""
    time, sensor, values, deviations = (part[j].tolist() for part in given)
    return KeptRow(time, slot, sensor, values, deviations)


def _rows_of(kept: list[KeptRow]) -> MeasuredRows:
    """Return readings of windows as columns."""
    times, _, sensors, values, deviations = zip(*kept, strict=True)
    return MeasuredRows(np.array(times), np.array(sensors), np.array(values), np.array(deviations))
