"""The filter over a whole batch of measurements: the loop over time, and what is kept of it."""

from __future__ import annotations

import torch

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.gate import Gate, check_gate
from ahnn.estimation.state import FilterState, initial_state
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow
from ahnn_plugins.ukf.checks import (
    check_belief,
    check_form,
    check_state,
    checked_rows,
    checked_sensor,
    checked_time,
)
from ahnn_plugins.ukf.loop import StepModel, run
from ahnn_plugins.ukf.sigma_points import unscented_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.steps import Grid, process_factor
from ahnn_plugins.ukf.types import (
    FilterResult,
    Form,
    ProcessNoise,
    UnscentedParameters,
)


def unscented_filter(
    flow: Flow,
    belief: Belief | FilterState,
    measurements: Numbers,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Covariance,
    dt: Numbers,
    *,
    parameters: UnscentedParameters | None = None,
    form: Form = SQUARE_ROOT,
    gate: Gate | None = None,
    smoothing: bool = False,
    start_time: float = 0.0,
    gradients: bool = False,
) -> FilterResult:
    """Run an unscented Kalman filter with additive noise over a batch of trajectories.

    Step k takes the belief from t_k to t_{k+1} = t_k + dt_k, adds Q, and conditions on row k of the
    measurements, which were made at t_{k+1}. It is `UnscentedKalmanFilter` over a batch of rows.

    Args:
        flow: any function (x (N, D), dt) -> (N, D); called once a step, with N = B (2 D + 1).
        belief: about the states at the start, see `initial_belief`; or the state of an earlier run, to go on
            with its gate, status and time.
        measurements: (B, T, M), NaN where a component is missing; these and the numbers below may be
            tensors, arrays or lists.
        measurement: the model of the measurements.
        process_noise: Q of one step, (D, D) or (B, D, D), or a function of the step's length.
        measurement_noise: R, (M, M) or (B, M, M).
        dt: length of every step, or (T,) lengths; positive.
        parameters: of the sigma points; the defaults of `UnscentedParameters` if None.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: refuses improbable measurement rows; None takes all.
        smoothing: keep what `unscented_smoother` needs.
        start_time: time of the initial belief; a state has its own.
        gradients: keep the graph, to learn from `log_likelihood`, say; costs memory.

    Raises:
        ValueError: names the parameter: inputs of another type or shape, complex numbers, infinite
            measurements, matrices that are not covariances, steps that are not positive, or parameters
            without sigma points; from within the loop for a flow or a measurement model that returns another
            shape, and for a process noise that gives no covariance for one of the lengths. Failures of single
            members raise nothing: they are in the result's `status`.
    """
    check_form(form)
    check_gate(gate, "gate")
    state = _initial(belief, start_time)
    with torch.set_grad_enabled(gradients):
        sensor = checked_sensor(measurement, measurement_noise, state.belief, form, gate)
        (batch, size), device = state.belief.mean.shape, state.belief.mean.device
        rows = checked_rows(measurements, "measurements", (batch, "T", len(measurement.names)), device)
        grid = Grid.of(dt, rows.shape[1], state.time)
        parameters = UnscentedParameters() if parameters is None else parameters
        weights = unscented_weights(parameters, size, device, batch=batch)
        chol_q = process_factor(process_noise, state.belief)
        model = lambda k: StepModel(flow, chol_q(grid.lengths[k]), sensor)  # noqa: E731
        return run(state, rows, grid, model, weights, form, smoothing=smoothing)


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
