"""What filters with additive noise share: arguments, gate, missing numbers, status of members, whole batches.

A filter holds no data: all that it knows is in the state, which goes in and comes out, and may be kept, saved
(`ahnn.estimation.save_state`) and gone on with. Gradients flow through every step. A member that fails gets a
status and raises nothing, but it may make the gradient of what it shares with others NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Generic, Self, TypeVar, cast

import torch
from torch import Tensor

from ahnn.estimation.argument_checks import (
    check_belief,
    check_state,
    checked_rows,
    checked_sensor,
    checked_step,
    checked_time,
)
from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.estimator import Batch, Innovation, SensorModel, Smoothed
from ahnn.estimation.gate import Gate, check_gate
from ahnn.estimation.loop import FilterLoop, StepModel, run
from ahnn.estimation.results import Backward, FilterResult, ProcessNoise, Updated
from ahnn.estimation.state import MemberState
from ahnn.estimation.step_noise import StepGrid, process_factor
from ahnn.estimation.step_records import StepRecord
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow

M = TypeVar("M", bound=MemberState)


class MemberFilter(ABC, Generic[M]):
    """A filter with additive noise for a batch of B members; an `Estimator` whose subclasses are dataclasses.

    Attributes:
        carried: class of its states.
        gate: refuses improbable measurement rows; None takes all.
    """

    carried: ClassVar[type[MemberState]]
    gate: Gate | None

    def __post_init__(self) -> None:
        """Refuse what is no gate; raises ValueError."""
        check_gate(self.gate, "gate")

    @property
    @abstractmethod
    def name(self) -> str:
        """What its rows are called, and its node of the configuration."""

    @property
    def definite(self) -> bool:
        """Whether it needs a measurement noise that is positive definite."""
        return False

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine its estimates."""
        return {"estimator": self.name, "gate": self.gate}

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Smoothers by name."""
        return {}

    @abstractmethod
    def initial(self, belief: Belief, time: float) -> M:
        """Return the state of a belief; raises ValueError for constants that do not fit it."""

    @abstractmethod
    def predicted(
        self, state: M, flow: Flow, dt: float, time: Tensor, chol_q: Tensor, *, smoothing: bool = False
    ) -> tuple[M, Backward | None]:
        """Return the state after a step of the flow that ends at `time`, and the law back, if asked for."""

    @abstractmethod
    def updated(self, state: M, y: Tensor, sensor: SensorModel) -> tuple[M, Updated, Tensor]:
        """Return the state given a row (B, M), the update, and which rows the gate rejected, (B,) bool."""

    def steps(self, state: M, rows: Tensor, *, smoothing: bool) -> FilterLoop[M]:
        """Return the steps of a run over rows (B, T, M)."""
        del state, rows

        def step(
            k: int,  # noqa: ARG001
            state: M,
            row: Tensor | None,
            model: StepModel,
            length: float,
            time: Tensor,
        ) -> tuple[M, StepRecord]:
            before, law = self.predicted(state, model.flow, length, time, model.chol_q, smoothing=smoothing)
            if row is None:
                return before, StepRecord(before.belief, before.belief, None, None, law)
            after, updated, rejected = self.updated(before, row, model.sensor)
            return after, StepRecord(before.belief, after.belief, updated, rejected, law)

        return step

    def gated(self, gate: Gate | None) -> Self:
        """Return the same with another gate."""
        return replace(self, gate=gate)  # pyright: ignore[reportArgumentType] - subclasses are dataclasses

    def start(self, belief: Belief, time: float = 0.0) -> M:
        """Return the state of a belief, see `initial_belief`, that holds at a time.

        Raises:
            ValueError: no float64 belief, a time that is not finite, or constants that do not fit it.
        """
        check_belief(belief)
        return self.initial(belief, checked_time(time, "time"))

    def predict(self, state: M, flow: Flow, dt: float, process_noise: ProcessNoise) -> M:
        """Return the state after one step of the flow.

        Args:
            state: before the step.
            flow: any function (x (N, D), dt) -> (N, D).
            dt: length of the step, positive.
            process_noise: Q of the step, (D, D) or (B, D, D), its `Factor`, or a function of its length.

        Raises:
            ValueError: no state, a step that is not positive, a Q that is no covariance, or a flow that
                returns another shape or complex numbers.
        """
        check_state(state, self.carried)
        length = checked_step(dt)
        chol_q = process_factor(process_noise, state.belief)(length)
        after, _ = self.predicted(state, flow, length, state.time + length, chol_q)
        return after

    def update(
        self, state: M, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[M, Innovation]:
        """Return the state given a row that was measured at its time, and what the row told.

        Rows of several independent sensors are updates one after the other; a row at the start is an update
        before the first prediction.

        Args:
            state: before the update.
            y: (B, M), NaN where a component is missing.
            measurement: the model of the measurement.
            measurement_noise: R, (M, M) or (B, M, M), or its `Factor`; it may differ from row to row.

        Raises:
            ValueError: no state, a row of another shape or infinite, an R that is no covariance, or a model
                that returns another shape or complex numbers.
        """
        check_state(state, self.carried)
        sensor = checked_sensor(
            measurement, measurement_noise, state.belief, self.gate, definite=self.definite
        )
        batch, device = len(state.belief.mean), state.belief.mean.device
        row = checked_rows(y, "y", (batch, len(measurement.names)), device)
        if bool(row.isnan().all()):
            return state, Innovation.of_nothing(row)
        after, updated, rejected = self.updated(state, row, sensor)
        return after, _told(state, after, row, updated, rejected)

    def run(
        self,
        flow: Flow,
        belief: Belief | M,
        measurements: Numbers,
        measurement: Measurement,
        process_noise: ProcessNoise,
        measurement_noise: Covariance,
        dt: Numbers,
        *,
        smoothing: bool = False,
        start_time: float = 0.0,
        gradients: bool = False,
    ) -> FilterResult:
        """Filter a batch of trajectories.

        Step k takes the belief from t_k to t_{k+1} = t_k + dt_k, adds Q, and conditions on row k of the
        measurements, which were made at t_{k+1}.

        Args:
            flow: any function (x (N, D), dt) -> (N, D).
            belief: about the states at the start, see `initial_belief`; or the state of an earlier run, to go
                on with its gate, status and time.
            measurements: (B, T, M), NaN where a component is missing; these and the numbers below may be
                tensors, arrays or lists.
            measurement: the model of the measurements.
            process_noise: Q of one step, (D, D) or (B, D, D), or a function of the step's length.
            measurement_noise: R, (M, M) or (B, M, M).
            dt: length of every step, or (T,) lengths; positive.
            smoothing: keep what `smoother` needs.
            start_time: time of the initial belief; a state has its own.
            gradients: keep the graph, to learn from `log_likelihood`, say; costs memory.

        Raises:
            ValueError: names the parameter: inputs of another type or shape, complex numbers, infinite
                measurements, matrices that are not covariances, steps that are not positive, or constants
                that do not fit; from within the loop for a flow or a measurement model that returns
                another shape, and for a process noise that gives no covariance for one of the lengths.
                Failures of single members raise nothing: they are in the result's `status`.
        """
        state = self._begun(belief, start_time)
        with torch.set_grad_enabled(gradients):
            sensor = checked_sensor(
                measurement, measurement_noise, state.belief, self.gate, definite=self.definite
            )
            batch, device = len(state.belief.mean), state.belief.mean.device
            shape = (batch, "T", len(measurement.names))
            rows = checked_rows(measurements, "measurements", shape, device)
            grid = StepGrid.of(dt, rows.shape[1], state.time)
            chol_q = process_factor(process_noise, state.belief)
            model = lambda k: StepModel(flow, chol_q(grid.lengths[k]), sensor)  # noqa: E731
            return run(state, rows, grid, model, self.steps(state, rows, smoothing=smoothing))

    def _begun(self, belief: Belief | M, start_time: float) -> M:
        """Return the state that a run begins with."""
        if not isinstance(belief, self.carried):
            return self.start(cast(Belief, belief), checked_time(start_time, "start_time"))
        state = cast(M, belief)
        check_state(state, self.carried)
        if start_time != 0.0:
            message = f"start_time: expected none beside a state, which has its own; received {start_time}"
            raise ValueError(message)
        return state


def _told(
    before: MemberState, after: MemberState, y: Tensor, updated: Updated, rejected: Tensor
) -> Innovation:
    """Return what a row told; NaN for members that failed at it or before."""
    present = ~torch.isnan(y)
    there = present & after.alive[:, None]
    residual, deviation, nis = updated.innovation, updated.deviation, updated.nis
    if not bool(there.all()):
        residual, deviation = (torch.where(there, part, torch.nan) for part in (residual, deviation))
        nis = torch.where(there.any(-1), nis, torch.nan)
    gain = after.log_likelihood - before.log_likelihood
    return Innovation(residual, deviation, nis, present.sum(-1), rejected, gain)
