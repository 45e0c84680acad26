"""Batched filtering of one reading per object, each at its own time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ahnn.assimilation.reading_table import Array, Places
from ahnn.assimilation.stream_models import StreamModels
from ahnn.cores import each
from ahnn.estimation import Factor, FilterState
from ahnn.estimation.member_steps import empty_rows, measured_at, member_rows, put_rows

TOGETHER = 1024
"""Number of objects that justifies one more core."""
FAULT = -1
"""Status of a reading that is not a valid measurement; all other values are statuses of filters."""


class MeasuredRows(NamedTuple):
    """One reading per object: times (B,), sensor indices (B,), values and deviations (B, W)."""

    times: Array
    sensors: Places
    values: Array
    deviations: Array

    def at(self, chosen: Places) -> MeasuredRows:
        """Return selected readings."""
        times, sensors, values, deviations = self
        return MeasuredRows(times[chosen], sensors[chosen], values[chosen], deviations[chosen])


class MemberOutcome(NamedTuple):
    """Results of readings for B objects.

    Attributes:
        state: states after the readings; invalid for failed members.
        statuses: (B,) int64, 0 for valid members, `FAULT` for an invalid measurement.
        reopened: (B,) bool, whether the belief was widened so that the gate accepted the reading.
        rejected: (B,) bool, whether the gate rejected the reading.
        residuals: (B, W) measurement minus prediction, NaN where missing.
        deviations: (B, W) standard deviations of the residuals.
        nis: (B,) normalised innovation squared.
        measured: (B,) number of measured values.
    """

    state: FilterState
    statuses: Tensor
    reopened: Tensor
    rejected: Tensor
    residuals: Tensor
    deviations: Tensor
    nis: Tensor
    measured: Tensor

    @classmethod
    def room(cls, like: FilterState, count: int, width: int) -> MemberOutcome:
        """Allocate results of B readings, initially without measurements."""
        wide = torch.full((2, count, width), torch.nan, dtype=torch.float64)
        whole = torch.zeros(2, count, dtype=torch.int64)
        gate = torch.zeros(2, count, dtype=torch.bool)
        nis = torch.full((count,), torch.nan, dtype=torch.float64)
        return cls(empty_rows(like, count), whole[0], gate[0], gate[1], wide[0], wide[1], nis, whole[1])


class MemberUpdates:
    """Batched predictions and updates of members with the sensors of a stream.

    Args:
        models: process and sensors.
        columns: names of the W values of all sensors.
        spreads: (N, d, d) factors of the objects' initial covariances, or (1, d, d) for a common one.
    """

    def __init__(self, models: StreamModels, columns: tuple[str, ...], spreads: Tensor) -> None:
        self.spreads = spreads
        self.models, self.width, self.names = models, len(columns), [*models.sensors]
        own = [[columns.index(name) for name in one.columns] for one in models.sensors.values()]
        self.places = [torch.tensor(places) for places in own]

    def filtered(
        self, state: FilterState, numbers: Places, slots: Places, since: Array, given: MeasuredRows
    ) -> MemberOutcome:
        """Update beliefs from rows `slots` at times `since` (B,) with one reading per object, at its time."""
        outcome = MemberOutcome.room(state, len(slots), self.width)
        rows, begun = torch.from_numpy(slots), torch.from_numpy(since)
        own = torch.from_numpy(np.minimum(numbers, len(self.spreads) - 1))
        times, _, values, deviations = (torch.from_numpy(part) for part in given)
        blocks = [
            (sensor, block)
            for sensor in np.unique(given.sensors).tolist()
            for block in torch.from_numpy(np.flatnonzero(given.sensors == sensor)).split(TOGETHER)
        ]

        def work(part: tuple[int, Tensor]) -> None:
            sensor, block = part
            before, end = member_rows(state, rows[block]), times[block]
            predicted = self.models.process.members_advanced(before, begun[block], end)
            if sensor < 0:
                put_rows(outcome.state, block, predicted)
                outcome.statuses[block] = predicted.status
            else:
                measured = end, values[block], deviations[block], self.spreads[own[block]]
                self._update(sensor, block, predicted, measured, outcome)

        each(work, blocks, state.status.device)
        return outcome

    def _update(
        self,
        sensor: int,
        block: Tensor,
        before: FilterState,
        given: tuple[Tensor, Tensor, Tensor, Tensor],
        outcome: MemberOutcome,
    ) -> None:
        """Update a block of members with one sensor and store the results."""
        name, own = self.names[sensor], self.places[sensor]
        times, y, deviations = given[0], given[1][:, own], given[2][:, own]
        model = measured_at(self.models.seen[name], times)
        noise = self._noise(name, deviations)
        after, innovation = self.models.process.estimator.update(before, y, model, noise)
        if bool((lost := self.models.beyond_patience(after, innovation, y)).any()):
            own_noise = self._noise(name, deviations[lost])
            part = y[lost], measured_at(self.models.seen[name], times[lost]), own_noise
            wide, found, opened = self.models.reopened(member_rows(before, lost), *part, given[3][lost])
            where = lost.nonzero()[opened, 0]
            put_rows(after, where, member_rows(wide, opened))
            for whole, one in zip(innovation, found, strict=True):
                whole[where] = one[opened]
            outcome.reopened[block[where]] = True
        fault = self.models.at_fault(name, (before, after), innovation, y, model)
        put_rows(outcome.state, block, after)
        outcome.statuses[block] = torch.where(fault, FAULT, after.status)
        outcome.rejected[block] = innovation.rejected
        column = block.unsqueeze(1)
        outcome.residuals[column, own], outcome.deviations[column, own] = (
            innovation.residual,
            innovation.deviation,
        )
        outcome.nis[block], outcome.measured[block] = innovation.nis, innovation.measured

    def _noise(self, name: str, deviations: Tensor) -> Factor:
        """Return the factor of R of readings; their own standard deviations (B, M) take precedence."""
        sensor, missing = self.models.sensors[name], deviations.isnan()
        if sensor.deviations is not None:
            if bool(missing.all()):
                return sensor.factor(None)
            deviations = torch.where(missing, deviations.new_tensor(sensor.deviations), deviations)
        return Factor(torch.diag_embed(deviations))
