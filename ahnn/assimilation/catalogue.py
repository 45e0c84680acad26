"""Many objects followed at once: a filter of each, in steps that all of them take together."""

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
    """Filters of many objects, each as `Assimilation` follows one.

    Readings come in tables. The k-th readings of all objects of a table are one step of a batch in which
    each object has its own time: the estimates of an object are those of a filter of its own, to rounding.
    An object whose filter fails is lost: its last sound belief is kept, its later readings do not count, and
    others go on.

    Args:
        process: a filter of Gaussian beliefs and its process model, without controls.
        sensors: by name.
        start: beliefs about the states of the objects; or one belief, with which every object begins when it
            is first measured.
        objects: their names; None where they are not known before.
        times: at which the beliefs hold, one or one for each.
        window: readings that come late by up to this are put in their place and later ones replayed.
        lines: most readings of an object that are kept for that.
        gap: a reading that lies further ahead is refused; None is 10,000 steps of the flow.

    Raises:
        UserError: a value beyond its limits, another number of starts than of names, a name twice, a filter
            of other beliefs, or a process model with controls.
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
            message = "process: expected forces of state and time for many objects; received some of controls"
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
                message = f"process: expected a filter of Gaussian beliefs, as ukf and ekf; received {name}"
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
        """Return the estimates after readings, each merged in its place if it comes late.

        Raises:
            UserError: columns of other lengths or shapes, a sensor that there is none of, or times that are
                not finite.
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
        """Return readings of one sensor as a table.

        Args:
            objects: K names.
            times: (K,).
            values: (K, M) numbers of the sensor, NaN where one is missing.
            sensor: its name; None where there is one.
            deviations: (K, M) standard deviations in place of those of the sensor, NaN for these.

        Raises:
            UserError: a sensor that there is none of, or numbers of another shape.
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
        """Names of the objects that are followed or lost."""
        return [*self.objects.names]

    def beliefs(self) -> tuple[Array, Belief]:
        """Return the times (N,) and the beliefs about the states of all objects, in the order of `names`."""
        every = np.arange(len(self.objects.times))
        return self.objects.times.copy(), self.objects.beliefs(every, self.size)

    @property
    def lost(self) -> dict[str, Status]:
        """By name what ended the filters of objects that are lost."""
        pairs = zip(self.names, self.objects.lost.tolist(), strict=True)
        return {name: Status(status) for name, status in pairs if status}

    @property
    def identity(self) -> str:
        """What determines the estimates besides starts and readings, in 32 hexadecimal digits."""
        return self.models.identity((*self.limits, self.process.max_step))

    def save(self, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
        """Write all that is needed to go on; the file appears whole or not at all.

        Args:
            path: of the file.
            notes: texts that are kept beside the beliefs.
        """
        write_catalogue(self.objects, Path(path), self.identity, notes or {})

    @torch.no_grad()
    def load(self, path: str | Path) -> dict[str, str]:
        """Go on where `save` was called, and return the notes that were kept there.

        Raises:
            UserError: no such file, a damaged one, or one of another process, sensors or window.
        """
        known = None if self.newcomer is not None else self.names
        return read_catalogue(self.objects, Path(path), self.identity, known, len(self.columns))

    def _numbers(self, objects: list[str]) -> Places:
        """Return the numbers of objects, -1 of those that are unknown and do not begin now."""
        known = self.objects.names
        if self.newcomer is not None and (new := [*dict.fromkeys(o for o in objects if o not in known)]):
            state, time = self.newcomer
            self.objects.enrol(new, state, np.full(len(new), time))
        return np.array([known.get(name, -1) for name in objects], dtype=np.int64)

    def _require_fitting(self, readings: ReadingTable) -> None:
        """Refuse columns that are no readings; raises UserError."""
        objects, times, sensors, values, deviations = readings
        count, wide = (len(objects),), (len(objects), len(self.columns))
        shapes = [part.shape for part in (times, sensors, values, deviations)]
        if shapes != [count, count, wide, wide]:
            message = f"readings: expected columns of shapes {count} and {wide}; received {shapes}"
            raise UserError(message)
        if not np.isfinite(times).all() or np.isinf(values).any():
            message = (
                "readings: expected times and numbers that are finite, NaN of what is missing; received inf"
            )
            raise UserError(message)
        if len(sensors) and not -1 <= sensors.min() <= sensors.max() < len(self.sensors):
            message = f"readings: expected sensors from -1 to {len(self.sensors) - 1}; received others"
            raise UserError(message)
        for k, (name, sensor) in enumerate(self.sensors.items()):
            own = [self.columns.index(column) for column in sensor.columns]
            sds = deviations[sensors == k][:, own]
            lacking = sensor.deviations is None and np.isnan(sds).any()
            if lacking or (sds <= 0).any():
                message = f"sd: expected standard deviations > 0 of {name}; received others, or none"
                raise UserError(message)


def _checked_starts(start: Belief, names: list[str] | None, times: Numbers) -> Array:
    """Return the times (N,) of the starts of objects; raises UserError."""
    count = len(start.mean)
    if names is None and count != 1:
        message = f"start: expected one belief where no objects are named; received {count}"
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
        message = f"times: expected one that is finite, or {count}; received {tuple(moments.shape)}"
        raise UserError(message)
    return moments.expand(count).numpy().copy()


def _spelled(start: Belief, names: list[str], times: Array) -> dict[str, str]:
    """Return the hashes of starts, by the keys that say them."""
    parts = {
        "start": "\n".join(names).encode() + start.mean.numpy().tobytes(),
        "start_sd": start.covariance.numpy().tobytes(),
        "time": times.tobytes(),
    }
    return {key: hashlib.blake2b(part, digest_size=16).hexdigest() for key, part in parts.items()}
