"""Sequences of readings that need no decision: in order of time, complete, of one sensor, and accepted.

The estimator filters them in one call; results are bit-identical to filtering one by one.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

import torch

from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.late_readings import TIME, KeptReading, ReadingWindow
from ahnn.assimilation.stream_models import HOPELESS, StreamModels
from ahnn.estimation import Belief, FilterState, Innovation
from ahnn.estimation.argument_checks import checked_sensor
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.step_runs import FollowedRows, RunFilter, StepRun
from ahnn.substeps import substeps


class FollowedRun(NamedTuple):
    """Readings of a sequence with their results.

    Attributes:
        readings: n readings.
        innovations: n innovations.
        rows: beliefs after the readings, with residuals, NIS and log-likelihoods.
        before: state before the sequence.
        steps: n + 1 numbers of steps of the filter since its start, before and after the readings.
        log_likelihoods: n + 1 log-likelihoods, before and after the readings.
    """

    readings: Sequence[Reading]
    innovations: list[Innovation]
    rows: FollowedRows
    before: FilterState
    steps: list[int]
    log_likelihoods: list[float]

    def state(self, k: int) -> FilterState:
        """Return the state after reading k."""
        before, belief = self.before, Belief(self.rows.means[k : k + 1], self.rows.chols[k : k + 1])
        return FilterState(
            belief=belief,
            time=torch.tensor(self.readings[k].time, dtype=torch.float64),
            steps=torch.tensor(self.steps[k + 1], dtype=torch.int64),
            status=before.status,
            failed_step=before.failed_step,
            rejections=torch.zeros_like(before.rejections),
            repairs=before.repairs,
            log_likelihood=torch.tensor([self.log_likelihoods[k + 1]], dtype=torch.float64),
        )

    def window(self, old: ReadingWindow, span: float, most: int) -> ReadingWindow:
        """Return a window with these readings after its own, limited as by `ReadingWindow.kept`."""
        last, count, controls = self.readings[-1].time, len(self.readings), old.controls
        first = max(count - most, bisect_left(self.readings, last - span, key=TIME))
        new = tuple(
            KeptReading(self.readings[k].time, self.readings[k], self.state(k), self.innovations[k], controls)
            for k in range(first, count)
        )
        if first == 0:
            return old._replace(entries=(*old.entries, *new)).kept(span, most)
        return ReadingWindow(self.state(first - 1), self.readings[first - 1].time, controls, new)


class ReadingRuns:
    """Filter for sequences of readings.

    Args:
        models: process and sensors.
        gap: largest time from one reading to the next.
    """

    def __init__(self, models: StreamModels, gap: float) -> None:
        self.models, self.gap = models, gap
        estimator = models.process.estimator
        self.estimator = estimator if isinstance(estimator, RunFilter) else None
        self.sensors, self.unfit = dict[str, SensorModel](), set[str]()

    def followed(self, window: ReadingWindow, readings: Sequence[Reading]) -> FollowedRun | None:
        """Filter the first readings after a window; None if the first must be processed individually."""
        state, process, name = window.state, self.models.process, readings[0].sensor
        count = self._count(window.time, readings) if self.estimator and name not in self.unfit else 0
        if not count or not isinstance(state, FilterState):
            return None
        times = [window.time, *(reading.time for reading in readings[:count])]
        starts, lengths, measured = list[float](), list[float](), list[bool]()
        for begin, end in pairwise(times):
            parts = substeps(end - begin, process.max_step)
            length = (end - begin) / parts
            starts += accumulate([length] * (parts - 1), initial=begin)
            lengths += [length] * parts
            measured += [False] * (parts - 1) + [True]
        values = [[reading.values] for reading in readings[:count]]
        begun, steps, rows = (torch.tensor(one, dtype=torch.float64) for one in (starts, lengths, values))
        run = StepRun(begun, steps, process.noises(steps).chol.unsqueeze(1), measured, rows)
        assert self.estimator is not None
        most = HOPELESS * rows.shape[-1]
        found = self.estimator.follow(state, process.flow, run, self._sensor(name, state), most)
        if found is None:
            self.unfit.add(name)
        return _run(state, readings[: len(found.nis)], found, measured) if found and len(found.nis) else None

    def _count(self, time: float, readings: Sequence[Reading]) -> int:
        """Return how many readings after a time can form a sequence."""
        first = readings[0]
        for k, reading in enumerate(readings):
            alike = reading.sensor == first.sensor and len(reading.values) == len(first.values) > 0
            plain = alike and reading.deviations is None and not reading.controls
            if (
                not plain
                or not time < reading.time <= time + self.gap
                or not math.isfinite(sum(reading.values))
            ):
                return k
            time = reading.time
        return len(readings)

    def _sensor(self, name: str, state: FilterState) -> SensorModel:
        """Return the checked model of a sensor."""
        if name not in self.sensors:
            estimator, own = self.models.process.estimator, self.models.sensors[name]
            given = self.models.seen[name], own.factor(None), state.belief
            gate, definite = (getattr(estimator, key, None) for key in ("gate", "definite"))
            self.sensors[name] = checked_sensor(*given, gate, definite=bool(definite))
        return self.sensors[name]


def _run(
    before: FilterState, readings: Sequence[Reading], rows: FollowedRows, measured: list[bool]
) -> FollowedRun:
    """Return the results of readings; `measured` marks the steps that end at a reading."""
    ends = [k + 1 for k, is_end in enumerate(measured) if is_end][: len(readings)]
    steps = [int(before.steps) + k for k in (0, *ends)]
    logs = [*accumulate(rows.log_likelihoods.tolist(), initial=float(before.log_likelihood))]
    gains = torch.tensor([after - now for now, after in pairwise(logs)], dtype=torch.float64)
    count, accepted = torch.tensor([rows.residuals.shape[1]]), torch.zeros(1, dtype=torch.bool)
    parts = rows.residuals, rows.deviations, rows.nis, gains
    innovations = [
        Innovation(residual, deviation, nis, count, accepted, gain)
        for residual, deviation, nis, gain in zip(*(part.split(1) for part in parts), strict=True)
    ]
    return FollowedRun(readings, innovations, rows, before, steps, logs)
