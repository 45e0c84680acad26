"""A Gaussian filter from its kernel: one step at a time, or over a whole batch of rows.

It holds no data: all that it knows is in the state, which goes in and comes out, and may be kept, saved
(`ahnn.estimation.save_state`) and gone on with. Gradients flow through every step. A member that fails gets a
status and raises nothing, but it may make the gradient of what it shares with others NaN.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self

import torch
from torch import Tensor

from ahnn.estimation import kernel as decisions
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
from ahnn.estimation.estimator import Batch, Innovation, Kernel, Smoothed
from ahnn.estimation.gate import Gate, check_gate
from ahnn.estimation.loop import FilterLoop, StepModel, run, stepper
from ahnn.estimation.results import FilterResult, ProcessNoise, Updated
from ahnn.estimation.smoother import smoother
from ahnn.estimation.state import FilterState, initial_state
from ahnn.estimation.step_noise import StepGrid, process_factor
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow


class GaussianFilter(ABC):
    """A filter with additive noise for a batch of B members; an `Estimator` whose subclasses are dataclasses.

    Attributes:
        gate: refuses improbable measurement rows; None takes all.
    """

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
        """The Rauch-Tung-Striebel smoother."""
        return {"smoothed": lambda result, _: Smoothed(smoother(result))}

    @abstractmethod
    def kernel(self, belief: Belief) -> Kernel:
        """Return the kernel for beliefs of this shape, on this device."""

    def stepper(self, kernel: Kernel, rows: Tensor, *, smoothing: bool) -> FilterLoop:
        """Return the steps of a run over rows (B, T, M)."""
        del rows
        return stepper(kernel, smoothing=smoothing)

    def gated(self, gate: Gate | None) -> Self:
        """Return the same with another gate."""
        return replace(self, gate=gate)  # pyright: ignore[reportArgumentType] - subclasses are dataclasses

    def start(self, belief: Belief, time: float = 0.0) -> FilterState:
        """Return the state of a belief, see `initial_belief`, that holds at a time.

        Raises:
            ValueError: no float64 belief, a time that is not finite, or constants that make no kernel.
        """
        check_belief(belief)
        state = initial_state(belief, checked_time(time, "time"))
        self.kernel(belief)
        return state

    def predict(self, state: FilterState, flow: Flow, dt: float, process_noise: ProcessNoise) -> FilterState:
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
        check_state(state)
        length = checked_step(dt)
        chol_q = process_factor(process_noise, state.belief)(length)
        kernel = self.kernel(state.belief)
        after, _ = decisions.predict(state, kernel, flow, length, state.time + length, chol_q)
        return after

    def update(
        self, state: FilterState, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[FilterState, Innovation]:
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
        check_state(state)
        sensor = checked_sensor(
            measurement, measurement_noise, state.belief, self.gate, definite=self.definite
        )
        batch, device = len(state.belief.mean), state.belief.mean.device
        row = checked_rows(y, "y", (batch, len(measurement.names)), device)
        if bool(row.isnan().all()):
            return state, Innovation.of_nothing(row)
        after, updated, rejected = decisions.update(state, self.kernel(state.belief), row, sensor)
        return after, _told(state, after, row, updated, rejected)

    def run(
        self,
        flow: Flow,
        belief: Belief | FilterState,
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
                that make no kernel; from within the loop for a flow or a measurement model that returns
                another shape, and for a process noise that gives no covariance for one of the lengths.
                Failures of single members raise nothing: they are in the result's `status`.
        """
        state = _initial(belief, start_time)
        with torch.set_grad_enabled(gradients):
            sensor = checked_sensor(
                measurement, measurement_noise, state.belief, self.gate, definite=self.definite
            )
            batch, device = len(state.belief.mean), state.belief.mean.device
            shape = (batch, "T", len(measurement.names))
            rows = checked_rows(measurements, "measurements", shape, device)
            grid = StepGrid.of(dt, rows.shape[1], state.time)
            kernel = self.kernel(state.belief)
            chol_q = process_factor(process_noise, state.belief)
            model = lambda k: StepModel(flow, chol_q(grid.lengths[k]), sensor)  # noqa: E731
            return run(state, rows, grid, model, self.stepper(kernel, rows, smoothing=smoothing))


def _initial(belief: Belief | FilterState, start_time: float) -> FilterState:
    """Return the state that a run begins with."""
    if not isinstance(belief, FilterState):
        check_belief(belief)
        return initial_state(belief, checked_time(start_time, "start_time"))
    check_state(belief)
    if start_time != 0.0:
        message = f"start_time: expected none beside a state, which has its own; received {start_time}"
        raise ValueError(message)
    return belief


def _told(
    before: FilterState, after: FilterState, y: Tensor, updated: Updated, rejected: Tensor
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
