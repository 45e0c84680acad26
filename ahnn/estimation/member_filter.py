"""Base class of filters with additive noise: arguments, gating, missing data, member status, batches.

A filter stores no data: all information is in the state, which is passed in and returned, and may be kept,
saved (`ahnn.estimation.save_state`) and continued. Every step is differentiable. A failed member receives a
status and raises no error, but gradients with respect to shared inputs may become NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import cache
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
from ahnn.estimation.loop import FilterLoop, RunPlan, StepModel, run, stepper
from ahnn.estimation.results import Backward, FilterResult, ProcessNoise, Updated
from ahnn.estimation.state import MemberState
from ahnn.estimation.step_noise import StepGrid, process_factor
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow

M = TypeVar("M", bound=MemberState)


class MemberFilter(ABC, Generic[M]):
    """Filter with additive noise for a batch of B members; an `Estimator` whose subclasses are dataclasses.

    Attributes:
        carried: class of the filter's states.
        gate: gate for improbable measurement rows, or None.
    """

    carried: ClassVar[type[MemberState]]
    gate: Gate | None

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid gate."""
        check_gate(self.gate, "gate")

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in tables and in the configuration."""

    @property
    def definite(self) -> bool:
        """Whether the filter requires positive definite measurement noise."""
        return False

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        return {"estimator": self.name, "gate": self.gate}

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Smoothers by name."""
        return {}

    @abstractmethod
    def initial(self, belief: Belief, time: float) -> M:
        """Return the state of a belief; raises ValueError for incompatible constants."""

    @abstractmethod
    def predicted(
        self, state: M, flow: Flow, dt: float, time: Tensor, chol_q: Tensor, *, smoothing: bool = False
    ) -> tuple[M, Backward | None]:
        """Propagate the state over a step ending at `time`; optionally return the backward law."""

    @abstractmethod
    def updated(self, state: M, y: Tensor, sensor: SensorModel) -> tuple[M, Updated, Tensor]:
        """Condition the state on a row (B, M); return state, update, and gate rejections, (B,) bool."""

    def steps(self, state: M, plan: RunPlan, *, smoothing: bool) -> FilterLoop[M]:
        """Return the step function of a run."""
        return stepper(self.predicted, self.updated, smoothing=smoothing)

    def gated(self, gate: Gate | None) -> Self:
        """Return a copy with another gate."""
        return replace(self, gate=gate)  # pyright: ignore[reportArgumentType] - subclasses are dataclasses

    def start(self, belief: Belief, time: float = 0.0) -> M:
        """Return the state for a belief, see `initial_belief`, at a given time.

        Raises:
            ValueError: not a float64 belief, a time that is not finite, or incompatible constants.
        """
        check_belief(belief)
        return self.initial(belief, checked_time(time, "time"))

    def predict(self, state: M, flow: Flow, dt: float, process_noise: ProcessNoise) -> M:
        """Propagate the state over one step of the flow.

        Args:
            state: state before the step.
            flow: any function (x (N, D), dt) -> (N, D).
            dt: length of the step, positive.
            process_noise: covariance Q of the step, (D, D) or (B, D, D), its `Factor`, or a function of the
                step's length.

        Raises:
            ValueError: an invalid state, a step that is not positive, a Q that is not a covariance, or a flow
                that returns a wrong shape or complex numbers.
        """
        check_state(state, self.carried)
        length = checked_step(dt)
        chol_q = process_factor(process_noise, state.belief)(length)
        after, _ = self.predicted(state, flow, length, state.time + length, chol_q)
        return after

    def update(
        self, state: M, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[M, Innovation]:
        """Condition the state on a row measured at its time; return state and innovation.

        Rows of several independent sensors are processed by successive updates; a row at the initial time is
        an update before the first prediction.

        Args:
            state: state before the update.
            y: (B, M), NaN where a component is missing.
            measurement: measurement model.
            measurement_noise: covariance R, (M, M) or (B, M, M), or its `Factor`; may vary between rows.

        Raises:
            ValueError: an invalid state, a row of wrong shape or with infinite values, an R that is not a
                covariance, or a model that returns a wrong shape or complex numbers.
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
        return after, _of_update(state, after, row, updated, rejected)

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

        Step k propagates the belief from t_k to t_{k+1} = t_k + dt_k, adds Q, and conditions on measurement
        row k, made at t_{k+1}.

        Args:
            flow: any function (x (N, D), dt) -> (N, D).
            belief: belief about the initial states, see `initial_belief`; or the state of an earlier run, to
                continue with its status and time.
            measurements: (B, T, M), NaN where a component is missing; this and the arguments below may be
                tensors, arrays or lists.
            measurement: measurement model.
            process_noise: Q of one step, (D, D) or (B, D, D), or a function of the step's length.
            measurement_noise: R, (M, M) or (B, M, M).
            dt: length of every step, or (T,) lengths; positive.
            smoothing: whether to keep the backward laws needed by `smoother`.
            start_time: time of the initial belief; must be 0 for a state, which has its own time.
            gradients: whether to keep the graph, for example to learn from `log_likelihood`; costs memory.

        Raises:
            ValueError: an invalid argument, named in the message: wrong type or shape, complex numbers,
                infinite measurements, matrices that are not covariances, steps that are not positive, or
                incompatible constants. Raised during the run for a flow or measurement model that returns a
                wrong shape, and for a process noise function whose result is not a covariance for some
                length. Failures of individual members raise no error and appear in the result's `status`.
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
            model = cache(lambda length: StepModel(flow, chol_q(length), sensor))
            plan = RunPlan.of(rows, grid, lambda k: model(grid.lengths[k]))
            return run(state, plan, self.steps(state, plan, smoothing=smoothing))

    def _begun(self, belief: Belief | M, start_time: float) -> M:
        """Return the initial state of a run."""
        if not isinstance(belief, self.carried):
            return self.start(cast(Belief, belief), checked_time(start_time, "start_time"))
        state = cast(M, belief)
        check_state(state, self.carried)
        if start_time != 0.0:
            message = f"start_time: expected none with a state, which has its own time; received {start_time}"
            raise ValueError(message)
        return state


def _of_update(
    before: MemberState, after: MemberState, y: Tensor, updated: Updated, rejected: Tensor
) -> Innovation:
    """Return the innovation of a row; NaN for members that failed at this row or before."""
    present = ~torch.isnan(y)
    there = present & after.alive[:, None]
    residual, deviation, nis = updated.innovation, updated.deviation, updated.nis
    if not bool(there.all()):
        residual, deviation = (torch.where(there, part, torch.nan) for part in (residual, deviation))
        nis = torch.where(there.any(-1), nis, torch.nan)
    gain = after.log_likelihood - before.log_likelihood
    return Innovation(residual, deviation, nis, present.sum(-1), rejected, gain)
