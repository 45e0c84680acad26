"""The filter that steps: predict when time passes, update when a sensor reports."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import final

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.gate import Gate, check_gate
from ahnn.estimation.recursive import Innovation
from ahnn.estimation.state import FilterState, initial_state
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow
from ahnn_plugins.ukf import kernel
from ahnn_plugins.ukf.checks import (
    check_belief,
    check_form,
    check_state,
    checked_rows,
    checked_sensor,
    checked_step,
    checked_time,
)
from ahnn_plugins.ukf.sigma_points import unscented_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.steps import process_factor
from ahnn_plugins.ukf.types import Form, ProcessNoise, UnscentedParameters, Updated, Weights

DEFAULTS = UnscentedParameters()


@final
@dataclass(frozen=True)
class UnscentedKalmanFilter:
    """Unscented Kalman filter with additive noise, one step at a time, for a batch of B members.

    It holds no data: all that it knows is in the state, which goes in and comes out, and may be kept, saved
    (`ahnn.estimation.save_state`) and gone on with. `unscented_filter` is the same over a whole batch of
    measurements.

    Gradients flow through every step. A member that fails gets a status and raises nothing, but it may make
    the gradient of what it shares with others NaN.

    Attributes:
        parameters: of the sigma points.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: refuses improbable measurement rows; None takes all.

    Raises:
        ValueError: a form or a gate that is none.
    """

    parameters: UnscentedParameters = DEFAULTS
    form: Form = SQUARE_ROOT
    gate: Gate | None = None

    def __post_init__(self) -> None:
        """Refuse what is no form and no gate."""
        check_form(self.form)
        check_gate(self.gate, "gate")

    def start(self, belief: Belief, time: float = 0.0) -> FilterState:
        """Return the state of a belief, see `initial_belief`, that holds at a time.

        Raises:
            ValueError: no float64 belief, a time that is not finite, or parameters without sigma points.
        """
        check_belief(belief)
        state = initial_state(belief, checked_time(time, "time"))
        self._weights(state)
        return state

    def predict(self, state: FilterState, flow: Flow, dt: float, process_noise: ProcessNoise) -> FilterState:
        """Return the state after one step of the flow.

        Sigma points are drawn again after Q is added: without that an unscented filter does not equal the
        Kalman filter on a linear system.

        Args:
            state: before the step.
            flow: any function (x (N, D), dt) -> (N, D); called once, with N = B (2 D + 1).
            dt: length of the step, positive.
            process_noise: Q of the step, (D, D) or (B, D, D), its `Factor`, or a function of its length.

        Raises:
            ValueError: no state, a step that is not positive, a Q that is no covariance, or a flow that
                returns another shape or complex numbers.
        """
        check_state(state)
        length = checked_step(dt)
        chol_q = process_factor(process_noise, state.belief)(length)
        after, _ = kernel.predict(
            state, flow, length, state.time + length, chol_q, self._weights(state), self.form
        )
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
        sensor = checked_sensor(measurement, measurement_noise, state.belief, self.form, self.gate)
        batch, device = len(state.belief.mean), state.belief.mean.device
        row = checked_rows(y, "y", (batch, len(measurement.names)), device)
        if bool(row.isnan().all()):
            return state, _nothing(row)
        after, updated, rejected = kernel.update(state, row, sensor, self._weights(state), self.form)
        return after, _told(state, after, row, updated, rejected)

    def _weights(self, state: FilterState) -> Weights:
        batch, size = state.belief.mean.shape
        device = state.belief.mean.device
        if any(isinstance(value, Tensor) for value in self.parameters):
            return unscented_weights(self.parameters, size, device, batch=batch)
        return _weights_of_numbers(self.parameters, size, device)


@cache
def _weights_of_numbers(parameters: UnscentedParameters, size: int, device: torch.device) -> Weights:
    # Kept tensors must serve gradients, in whatever mode they are asked for first.
    with torch.inference_mode(mode=False), torch.no_grad():
        return unscented_weights(parameters, size, device)


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


def _nothing(y: Tensor) -> Innovation:
    """Return what a row of NaN tells."""
    nothing = torch.zeros(len(y), dtype=torch.int64, device=y.device)
    zeros = nothing.to(y.dtype)
    return Innovation(y, y, zeros + torch.nan, nothing, nothing.to(torch.bool), zeros)
