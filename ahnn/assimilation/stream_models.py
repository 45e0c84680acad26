"""Models of a stream: process and sensors acting on the augmented state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import torch
from torch import Tensor

from ahnn.assimilation.stream_identity import identity
from ahnn.assimilation.stream_sensor import StreamSensor, plain
from ahnn.assimilation.unit_mistakes import in_wrong_unit
from ahnn.estimation import EstimatorState, Gate, Innovation, Status
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.process_model import Process
from ahnn.estimation.reopening import reopened
from ahnn.estimation.sensor_error import SensorError
from ahnn.estimation.state import MemberState
from ahnn.measurements import Measurement

HOPELESS = 1e16
"""NIS of a value at 1e8 standard deviations: adding such an innovation to the state loses all its digits."""
FURTHEST = 10_000
"""Default limit on how far a reading may lie ahead, in steps of the flow."""
LOST = (Status.NOT_FINITE, Status.COLLAPSED, Status.IMPRECISE)
"""Failures of a filter caused by a single reading of absurd size or precision."""


class StreamModels:
    """Process and sensors of a stream, with sensor biases as estimated states.

    Args:
        process: estimator with its process model.
        sensors: sensors by name.
    """

    def __init__(self, process: Process, sensors: Mapping[str, StreamSensor]) -> None:
        self.sensors = dict(sensors)
        self.errors = SensorError.of({name: sensor.biases for name, sensor in sensors.items()})
        self.process = process if self.errors is None else self.errors.process(process)
        self.seen = {name: self._seen(name, sensor) for name, sensor in self.sensors.items()}

    def identity(self, limits: Mapping[str, float | None]) -> str:
        """Return the identity of all that determines estimates except start and readings."""
        sensors = {
            f"sensor {name}": [plain(one.measurement), one.deviations, *(one.biases or ())]
            for name, one in self.sensors.items()
        }
        return identity({**self.process.about, **sensors, **limits})

    def at_fault(
        self,
        sensor: str,
        states: tuple[EstimatorState, EstimatorState],
        innovation: Innovation,
        y: Tensor,
        model: Measurement,
    ) -> Tensor:
        """Return which of B readings are invalid, (B,) bool: filters fail, but not on expected measurements.

        Args:
            sensor: sensor of the readings.
            states: states before and after the readings.
            innovation: innovations of the readings.
            y: (B, M) measured values.
            model: measurement model of the sensor at the times of the readings.
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

    def beyond_patience(self, state: EstimatorState, innovation: Innovation, y: Tensor) -> Tensor:
        """Return the members, (B,) bool, whose gate has rejected `patience` or more consecutive readings.

        Readings y (B, M) in a wrong unit do not count: a wider belief would follow them.
        """
        gate: Gate | None = getattr(self.process.estimator, "gate", None)
        if gate is None or not gate.reopens:
            return torch.zeros_like(innovation.rejected)
        lost = innovation.rejected & (cast(MemberState, state).rejections >= gate.patience)
        return lost & ~in_wrong_unit(y, y - innovation.residual) if bool(lost.any()) else lost

    def reopened(
        self, before: EstimatorState, y: Tensor, model: Measurement, noise: Covariance, spread: Tensor
    ) -> tuple[EstimatorState, Innovation, Tensor]:
        """Process readings with beliefs widened to accept them; see `ahnn.estimation.reopening`."""
        filtering = cast("MemberFilter[Any]", self.process.estimator)
        return reopened(filtering, cast(MemberState, before), y, model, noise, spread)

    def _seen(self, name: str, sensor: StreamSensor) -> Measurement:
        """Return the measurement model of a sensor for the augmented state."""
        model = self.process.seen(sensor.measurement)
        return model if self.errors is None else self.errors.measurement(model, name)


def _lost(state: EstimatorState) -> Tensor:
    """Return which members have one of the statuses in `LOST`."""
    return torch.stack([state.status == status for status in LOST]).any(0)
