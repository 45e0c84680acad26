"""The loop over time: predict each step, update where something was measured, freeze what fails."""

from __future__ import annotations

from typing import NamedTuple

import torch
from scipy.stats import chi2
from torch import Tensor

from ahnn.estimation.belief import Belief, Gate, Status
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers, described
from ahnn.types import Flow
from ahnn_plugins.ukf import members as books
from ahnn_plugins.ukf.checks import Inputs, checked_inputs
from ahnn_plugins.ukf.members import Members
from ahnn_plugins.ukf.records import Step, collected
from ahnn_plugins.ukf.sigma_points import draw, unscented_weights
from ahnn_plugins.ukf.smoother import backward_kernel
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.types import FilterResult, Form, ProcessNoise, UnscentedParameters, Updated, Weights


class _Problem(NamedTuple):
    """What does not change from step to step."""

    flow: Flow
    measurement: Measurement
    inputs: Inputs
    weights: Weights
    form: Form
    thresholds: Tensor
    patience: int
    smoothing: bool


@torch.no_grad()
def unscented_filter(
    flow: Flow,
    belief: Belief,
    measurements: Numbers,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Numbers,
    dt: Numbers,
    *,
    parameters: UnscentedParameters | None = None,
    form: Form = SQUARE_ROOT,
    gate: Gate | None = None,
    smoothing: bool = False,
    start_time: float = 0.0,
) -> FilterResult:
    """Run an unscented Kalman filter with additive noise over a batch of trajectories.

    Step k takes the belief from t_k to t_{k+1} = t_k + dt_k, adds Q, and conditions on row k of the
    measurements, which were made at t_{k+1}. Sigma points are drawn again after Q is added: without that an
    unscented filter does not equal the Kalman filter on a linear system.

    Args:
        flow: any function (x (N, D), dt) -> (N, D); called once a step, with N = B (2 D + 1).
        belief: about the states at the start, see `initial_belief`.
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
        start_time: time of the initial belief.

    Raises:
        ValueError: for inputs of another type or shape, infinite measurements, matrices that are not
            covariances, steps that are not positive, or parameters without sigma points; from within the
            loop for a flow or a measurement model that returns another shape, and for a process noise
            that gives no covariance for one of the lengths. Failures of single members raise nothing: they
            are in the result's `status`.
    """
    inputs = checked_inputs(
        belief, measurements, measurement, process_noise, measurement_noise, dt, form, start_time
    )
    parameters = UnscentedParameters() if parameters is None else parameters
    batch, size = belief.mean.shape
    problem = _Problem(
        flow=flow,
        measurement=measurement,
        inputs=inputs,
        weights=unscented_weights(parameters, size, belief.mean.device, batch=batch),
        form=form,
        thresholds=_thresholds(gate, inputs.measurements),
        patience=0 if gate is None else gate.patience,
        smoothing=smoothing,
    )
    members = books.start(belief)
    current, steps = belief, []
    for k in range(len(inputs.dt)):
        members, step = _step(problem, members, current, belief, k)
        steps.append(step)
        current = step.posterior
    return collected(steps, members, belief, inputs.measurements)


def _step(
    problem: _Problem, members: Members, belief: Belief, initial: Belief, k: int
) -> tuple[Members, Step]:
    """Predict over step k and update with row k."""
    weights, inputs = problem.weights, problem.inputs
    propagated = _propagate(problem.flow, draw(belief, weights), inputs.dt[k])
    chol_q = inputs.chol_q(inputs.dt[k])
    predicted, repaired = problem.form.predict(propagated, weights, chol_q)
    members = books.add_repairs(members, repaired)
    members = _checked_prediction(members, predicted, k)
    predicted = books.frozen(members, predicted, initial)
    backward = None
    if problem.smoothing:
        backward, mended = backward_kernel(propagated, belief.chol, weights, chol_q)
        if mended is not None and repaired is not None:
            # The kernel holds the predicted covariance: what was mended there is no second repair.
            mended = mended & ~repaired
        members = books.add_repairs(members, mended)
    if not inputs.is_measured[k]:
        return members, Step(predicted, predicted, None, None, backward)
    images = _measured(problem.measurement, draw(predicted, weights), inputs.times[k])
    updated = problem.form.update(
        predicted, images, inputs.measurements[:, k], problem.measurement.residual, weights, inputs.chol_r
    )
    members, posterior, rejected = _decide(problem, members, predicted, updated, k)
    posterior = books.frozen(members, posterior, initial)
    return members, Step(predicted, posterior, updated, rejected, backward)


def _propagate(flow: Flow, points: Tensor, dt: float) -> Tensor:
    """Return the points (B, S, D) after the flow, in one call on all of them."""
    flat = points.reshape(-1, points.shape[-1])
    propagated = flow(flat, dt)
    if not isinstance(propagated, Tensor) or propagated.shape != flat.shape:
        message = (
            f"unscented_filter: expected flow(x, dt) to return a tensor of the shape of x, "
            f"{tuple(flat.shape)}, got {described(propagated)}"
        )
        raise ValueError(message)
    return propagated.to(points.dtype).reshape(points.shape)


def _measured(measurement: Measurement, points: Tensor, t: float) -> Tensor:
    """Return the measurements (B, S, M) of the points (B, S, D) at time t."""
    images = measurement(points, t)
    expected = (*points.shape[:-1], len(measurement.names))
    if not isinstance(images, Tensor) or images.shape != expected:
        message = (
            f"unscented_filter: expected measurement(x, t) to return a tensor {expected} for x "
            f"{tuple(points.shape)} and the names {measurement.names}, got {described(images)}"
        )
        raise ValueError(message)
    return images


def _checked_prediction(members: Members, predicted: Belief, k: int) -> Members:
    """Give a status to members whose prediction is not finite, or has a variance of zero."""
    variance = predicted.chol.square().sum(-1)
    smallest, largest = torch.aminmax(variance)
    # NaN is in both and fails both comparisons.
    if float(smallest) > 0.0 and float(largest) < torch.inf:
        return members
    finite = torch.isfinite(variance).all(-1) & torch.isfinite(predicted.mean).all(-1)
    members = books.fail(members, ~finite, Status.NOT_FINITE, k)
    return books.fail(members, (variance == 0.0).any(-1), Status.COLLAPSED, k)


def _decide(
    problem: _Problem, members: Members, predicted: Belief, updated: Updated, k: int
) -> tuple[Members, Belief, Tensor]:
    """Take or refuse the update, member by member; return also which rows the gate rejected, (B,) bool."""
    count = problem.inputs.present[:, k].sum(-1)
    has_row = (count > 0) & members.alive
    finite = torch.isfinite(updated.belief.chol.square().sum((-2, -1)))
    finite = finite & torch.isfinite(updated.belief.mean).all(-1) & torch.isfinite(updated.nis)
    members = books.fail(members, has_row & updated.singular, Status.COLLAPSED, k)
    members = books.fail(members, has_row & ~finite, Status.NOT_FINITE, k)
    has_row = has_row & members.alive
    rejected = has_row & (updated.nis > problem.thresholds[count])
    accepted = has_row & ~rejected
    repairs = None if updated.repairs is None else updated.repairs * accepted
    members = books.add_repairs(members, repairs)
    members = members._replace(
        rejections=torch.where(accepted, 0, members.rejections + rejected),
        log_likelihood=members.log_likelihood + torch.where(accepted, updated.log_likelihood, 0.0),
    )
    members = books.fail(members, rejected & (members.rejections >= problem.patience), Status.DIVERGED, k)
    return members, books.choose(accepted, updated.belief, predicted), rejected


def _thresholds(gate: Gate | None, measurements: Tensor) -> Tensor:
    """Return the largest NIS that is taken, (M + 1,), by the number of components that are there."""
    size = measurements.shape[-1]
    if gate is None:
        return measurements.new_full((size + 1,), torch.inf)
    if not isinstance(gate, Gate) or not 0.0 < gate.probability < 1.0 or gate.patience < 1:
        message = f"unscented_filter: expected a Gate(probability in (0, 1), patience >= 1), got {gate!r}"
        raise ValueError(message)
    values = [0.0, *(float(chi2.ppf(gate.probability, n)) for n in range(1, size + 1))]
    return torch.tensor(values, dtype=torch.float64, device=measurements.device)
