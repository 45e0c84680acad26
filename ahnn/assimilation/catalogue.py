"""Simultaneous filtering of many objects: one filter per object, advanced in common batches."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import torch

from ahnn.arguments import Count, Positive, Within, checked
from ahnn.assimilation.catalogue_file import read_catalogue, write_catalogue
from ahnn.assimilation.catalogue_rounds import CatalogueRounds, Limits
from ahnn.assimilation.member_updates import MemberUpdates
from ahnn.assimilation.object_windows import FollowedObjects
from ahnn.assimilation.reading_table import Array, CatalogueEstimates, Places, ReadingTable, rounds
from ahnn.assimilation.stream_models import FURTHEST, StreamModels
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.errors import UserError
from ahnn.estimation import Belief, FilterState, Status
from ahnn.estimation.process_model import Process
from ahnn.numbers import Numbers, as_float64
from ahnn.rollouts import clock_of


class Catalogue:
    """Filters of many objects, each equivalent to an `Assimilation`.

    Readings arrive in tables. The k-th readings of all objects in a table form one batch step in which each
    object has its own time: estimates equal those of individual filters up to rounding. An object whose
    filter fails is lost: its last valid belief is kept, its later readings are ignored, and the other objects
    continue.

    Args:
        process: a Gaussian filter and its process model, without controls.
        sensors: sensors by name.
        start: beliefs about the states of the objects, or one initial belief for objects that are added at
            their first measurement.
        objects: names of the objects; None if unknown in advance.
        times: times of the beliefs, common or per object.
        window: largest delay of a late reading, which is inserted at its time while later ones are replayed.
        lines: largest number of readings kept per object for replay.
        gap: largest time ahead of an accepted reading; None for 10,000 steps of the flow.

    Raises:
        UserError: a value outside its limits, unequal numbers of starts and names, a duplicate name, a filter
            without Gaussian beliefs, or a process model with controls.
    """

    @checked
    def __init__(
        self,
        process: Process,
        sensors: Mapping[str, StreamSensor],
        start: Belief,
        objects: Sequence[str] | None = None,
        *,
        times: Numbers = 0.0,
        window: Annotated[float, Within(0)] = 0.0,
        lines: Count = 1000,
        gap: Positive | None = None,
    ) -> None:
        names = [] if objects is None else list(objects)
        moments = _checked_starts(start, None if objects is None else names, times)
        if clock_of(process.flow) > 1:
            message = (
                "process: expected forces that depend only on state and time, for many objects; received "
                "forces that depend on controls"
            )
            raise UserError(message)
        self.sensors, self.size = dict(sensors), start.mean.shape[-1]
        self.limits = Limits(window, lines, FURTHEST * process.max_step if gap is None else gap)
        self.columns = tuple(dict.fromkeys(name for one in sensors.values() for name in one.columns))
        with torch.no_grad():
            self.models = StreamModels(process, sensors)
            self.process = self.models.process
            state = self.process.estimator.start(self.process.lifted(start), 0.0)
            if not isinstance(state, FilterState):
                name = process.estimator.name
                message = f"process: expected a Gaussian filter, such as ukf or ekf; received {name}"
                raise UserError(message)
            self.objects = FollowedObjects(state)
            self.newcomer = None if objects is not None else (state, float(moments[0]))
            if objects is not None:
                self.objects.enrol(names, state, moments)
        self.begun = _spelled(start, names, moments)
        updates = MemberUpdates(self.models, self.columns, start.chol)
        self._rounds = CatalogueRounds(self.objects, updates, self.limits)

    @torch.no_grad()
    def update(self, readings: ReadingTable) -> CatalogueEstimates:
        """Process readings, merging late ones at their times, and return the estimates after each.

        Raises:
            UserError: columns of wrong lengths or shapes, an unknown sensor, or times that are not finite.
        """
        self._require_fitting(readings)
        found = CatalogueEstimates.unknown(len(readings.objects), self.size, len(self.columns))
        numbers = self._numbers(readings.objects)
        for rows in rounds(numbers):
            self._rounds.take(rows, numbers[rows], readings, found)
        return found

    def table(
        self,
        objects: Sequence[str],
        times: Numbers,
        values: Numbers,
        sensor: str | None = None,
        deviations: Numbers | None = None,
    ) -> ReadingTable:
        """Build a table of readings of one sensor.

        Args:
            objects: K object names.
            times: (K,) times.
            values: (K, M) measured values, NaN where missing.
            sensor: name of the sensor; None if there is only one.
            deviations: (K, M) standard deviations, NaN: as set for the sensor.

        Raises:
            UserError: an unknown sensor, or values of a wrong shape.
        """
        names = [*self.sensors]
        chosen = names[0] if sensor is None and len(names) == 1 else sensor
        if chosen not in self.sensors:
            message = f"sensor: expected one of {', '.join(names)}; received {sensor!r}"
            raise UserError(message)
        own, count = [self.columns.index(name) for name in self.sensors[chosen].columns], len(objects)
        parts = [np.full((count, len(self.columns)), np.nan) for _ in range(2)]
        for who, given, whole in zip(("values", "deviations"), (values, deviations), parts, strict=True):
            if given is not None:
                numbers = as_float64(given, who)
                if numbers.shape != (count, len(own)):
                    message = f"{who}: expected shape ({count}, {len(own)}); received {tuple(numbers.shape)}"
                    raise UserError(message)
                whole[:, own] = numbers.numpy()
        moments = as_float64(times, "times").numpy()
        return ReadingTable(list(objects), moments, np.full(count, names.index(chosen)), *parts)

    @property
    def names(self) -> list[str]:
        """Names of all tracked and lost objects."""
        return [*self.objects.names]

    def beliefs(self) -> tuple[Array, Belief]:
        """Return the times (N,) and the beliefs about the states of all objects, in the order of `names`."""
        every = np.arange(len(self.objects.times))
        return self.objects.times.copy(), self.objects.beliefs(every, self.size)

    @property
    def lost(self) -> dict[str, Status]:
        """Reason for the failure of each lost object, by name."""
        pairs = zip(self.names, self.objects.lost.tolist(), strict=True)
        return {name: Status(status) for name, status in pairs if status}

    @property
    def identity(self) -> str:
        """Hashes of everything that determines estimates except starts and readings."""
        return self.models.identity({**self.limits._asdict(), "step": self.process.max_step})

    def save(self, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
        """Save the complete state atomically, for resuming.

        Args:
            path: path of the file.
            notes: additional strings saved with the beliefs.
        """
        write_catalogue(self.objects, Path(path), self.identity, notes or {})

    @torch.no_grad()
    def load(self, path: str | Path) -> dict[str, str]:
        """Restore the state written by `save`, and return its notes.

        Raises:
            UserError: a missing or damaged file, or one saved with a different process, sensors or window.
        """
        known = None if self.newcomer is not None else self.names
        return read_catalogue(self.objects, Path(path), self.identity, known, len(self.columns))

    def _numbers(self, objects: list[str]) -> Places:
        """Return the indices of objects, -1 for unknown objects that cannot be added."""
        known = self.objects.names
        if self.newcomer is not None and (new := [*dict.fromkeys(o for o in objects if o not in known)]):
            state, time = self.newcomer
            self.objects.enrol(new, state, np.full(len(new), time))
        return np.array([known.get(name, -1) for name in objects], dtype=np.int64)

    def _require_fitting(self, readings: ReadingTable) -> None:
        """Raise UserError for columns that are not valid readings."""
        objects, times, sensors, values, deviations = readings
        count, wide = (len(objects),), (len(objects), len(self.columns))
        shapes = [part.shape for part in (times, sensors, values, deviations)]
        if shapes != [count, count, wide, wide]:
            message = f"readings: expected columns of shapes {count} and {wide}; received {shapes}"
            raise UserError(message)
        if not np.isfinite(times).all() or np.isinf(values).any():
            message = "readings: expected finite times and values, NaN where missing; received inf"
            raise UserError(message)
        if len(sensors) and not -1 <= sensors.min() <= sensors.max() < len(self.sensors):
            message = (
                f"readings: expected sensor numbers from -1 to {len(self.sensors) - 1}; received a number "
                "outside this range"
            )
            raise UserError(message)
        for k, (name, sensor) in enumerate(self.sensors.items()):
            own = [self.columns.index(column) for column in sensor.columns]
            sds = deviations[sensors == k][:, own]
            lacking = sensor.deviations is None and np.isnan(sds).any()
            if lacking or (sds <= 0).any():
                message = (
                    f"sd: expected a standard deviation > 0 for each measurement of {name}; received none "
                    "or one <= 0"
                )
                raise UserError(message)


def _checked_starts(start: Belief, names: list[str] | None, times: Numbers) -> Array:
    """Validate the starts of objects and return their times (N,); raises UserError."""
    count = len(start.mean)
    if names is None and count != 1:
        message = f"start: expected one belief if no objects are named; received {count}"
        raise UserError(message)
    if names is not None and len(names) != count:
        message = f"start: expected beliefs about {len(names)} objects; received {count}"
        raise UserError(message)
    if names is not None and len({*names}) < count:
        twice = next(name for name in names if names.count(name) > 1)
        message = f"objects: expected each name once; received {twice!r} twice"
        raise UserError(message)
    moments = as_float64(times, "times")
    if moments.shape not in ((), (count,)) or not bool(moments.isfinite().all()):
        message = f"times: expected one finite time, or {count} of them; received {tuple(moments.shape)}"
        raise UserError(message)
    return moments.expand(count).numpy().copy()


def _spelled(start: Belief, names: list[str], times: Array) -> dict[str, str]:
    """Return hashes of the starts by configuration key."""
    parts = {
        "start": "\n".join(names).encode() + start.mean.numpy().tobytes(),
        "start_sd": start.covariance.numpy().tobytes(),
        "time": times.tobytes(),
    }
    return {key: hashlib.blake2b(part, digest_size=16).hexdigest() for key, part in parts.items()}
