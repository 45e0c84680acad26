"""What filters a stream: the process, and models of its sensors, of all that is estimated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from ahnn.assimilation.stream_sensor import StreamSensor, plain
from ahnn.estimation import EstimatorState, Gate, Innovation, Status
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.process_model import Process
from ahnn.estimation.reopening import reopened
from ahnn.estimation.sensor_error import SensorError
from ahnn.estimation.state import MemberState
from ahnn.measurements import Measurement

HOPELESS = 1e16
"""NIS of a number, 1e8 standard deviations: what is added to the state has no digit of it left."""
FURTHEST = 10_000
"""Steps of the flow that a reading may lie ahead, where nothing else is asked for."""
LOST = (Status.NOT_FINITE, Status.COLLAPSED, Status.IMPRECISE)
"""What a single reading of absurd size, or of absurd precision, makes of a filter."""


class StreamModels:
    """A process and the sensors of a stream, their biases among what is estimated.

    Args:
        process: the estimator and its process model.
        sensors: by name.
    """

    def __init__(self, process: Process, sensors: Mapping[str, StreamSensor]) -> None:
        self.sensors = dict(sensors)
        self.errors = SensorError.of({name: sensor.biases for name, sensor in sensors.items()})
        self.process = process if self.errors is None else self.errors.process(process)
        self.seen = {name: self._seen(name, sensor) for name, sensor in self.sensors.items()}

    def identity(self, numbers: Sequence[float]) -> str:
        """Return what determines estimates besides start and readings, in 32 hexadecimal digits."""
        sensors = {
            name: [plain(one.measurement), one.deviations, *(one.biases or ())]
            for name, one in self.sensors.items()
        }
        content = json.dumps([self.process.about, sensors, numbers], sort_keys=True)
        return hashlib.blake2b(content.encode(), digest_size=16).hexdigest()

    def at_fault(
        self,
        sensor: str,
        states: tuple[EstimatorState, EstimatorState],
        innovation: Innovation,
        y: Tensor,
        model: Measurement,
    ) -> Tensor:
        """Return which of B readings are no measurements, (B,) bool: their filters take what they expect.

        Args:
            sensor: that they are of.
            states: before the readings and after them.
            innovation: what they told.
            y: (B, M) their numbers.
            model: of the sensor, at the times of the readings.
        """
        before, after = states
        absurd = (innovation.nis > HOPELESS * y.shape[1]) & ~innovation.rejected
        suspect = (_lost(after) | absurd) & ~y.isnan().all(-1)
        if not bool(suspect.any()):
            return suspect
        own = self.sensors[sensor]
        noise = own.factor(own.deviations or (1.0,) * len(own.columns))
        expected = model(before.moments.mean, float(before.time))
        y = torch.where(expected.isfinite(), expected, torch.nan)
        usual, _ = self.process.estimator.update(before, y, model, noise)
        return suspect & ~_lost(usual)

    def beyond_patience(self, state: EstimatorState, innovation: Innovation) -> Tensor:
        """Return the members, (B,) bool, whose gate has refused as many readings in a row as it may."""
        gate: Gate | None = getattr(self.process.estimator, "gate", None)
        if gate is None or not gate.reopens:
            return torch.zeros_like(innovation.rejected)
        return innovation.rejected & (cast(MemberState, state).rejections >= gate.patience)

    def reopened(
        self, before: EstimatorState, y: Tensor, model: Measurement, noise: Covariance, spread: Tensor
    ) -> tuple[EstimatorState, Innovation, Tensor]:
        """Return what readings make of beliefs that are widened for them; see `ahnn.estimation.reopening`."""
        filtering = cast("MemberFilter[Any]", self.process.estimator)
        return reopened(filtering, cast(MemberState, before), y, model, noise, spread)

    def _seen(self, name: str, sensor: StreamSensor) -> Measurement:
        """Return the model of a sensor, of all that is estimated."""
        model = self.process.seen(sensor.measurement)
        return model if self.errors is None else self.errors.measurement(model, name)


def _lost(state: EstimatorState) -> Tensor:
    """Return which members are lost in one of the ways of `LOST`."""
    return torch.stack([state.status == status for status in LOST]).any(0)
