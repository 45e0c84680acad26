"""One prediction and one update of the filter: pure functions of a state, with checked arguments.

What fails gives its member a status and freezes it, see `ahnn.estimation.state`.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Status, choose
from ahnn.estimation.state import FilterState, add_repairs, fail, frozen
from ahnn.measurements import Measurement, Position, State, nearest, residual
from ahnn.numbers import described
from ahnn.types import Flow
from ahnn_plugins.ukf.rounding import lost_in_prediction, lost_in_update
from ahnn_plugins.ukf.sigma_points import draw
from ahnn_plugins.ukf.types import Form, Updated, Weights

READINGS = (Position, State)
"""Models of the first components of a state; a class made from one may do something else."""


class Sensor(NamedTuple):
    """A measurement model and what is believed of it.

    Attributes:
        measurement: the model.
        chol_r: (B, M, M) factor of R.
        thresholds: (M + 1,) largest NIS that is taken, by the number of components that are there; None takes
            all.
        patience: rejections in a row that end a member.
    """

    measurement: Measurement
    chol_r: Tensor
    thresholds: Tensor | None
    patience: float


class Propagated(NamedTuple):
    """What a smoother needs of a prediction: points after the flow, and which members were repaired."""

    points: Tensor
    repaired: Tensor | None


def predict(
    state: FilterState, flow: Flow, dt: float, time: Tensor, chol_q: Tensor, weights: Weights, form: Form
) -> tuple[FilterState, Propagated]:
    """Return the state after a step of the flow that ends at `time`."""
    points = propagate(flow, draw(state.belief, weights), dt)
    return predict_from(points, state, time, chol_q, weights, form)


def predict_from(
    points: Tensor, state: FilterState, time: Tensor, chol_q: Tensor, weights: Weights, form: Form
) -> tuple[FilterState, Propagated]:
    """Return the state at `time`, given the sigma points (B, S, D) of the state after the flow."""
    predicted, repaired, sound = form.predict(points, weights, chol_q)
    after = add_repairs(FilterState(predicted, time, state.steps + 1, *state[3:]), repaired)
    if not sound:
        after = _checked_prediction(after)
    if weights.crowding is not None or form.squares:
        lost = lost_in_prediction(state.belief, predicted, weights, squares=form.squares)
        after = fail(after, _not_mended(lost, repaired, weights), Status.IMPRECISE)
    return frozen(after, state.belief), Propagated(points, repaired)


def update(
    state: FilterState, y: Tensor, sensor: Sensor, weights: Weights, form: Form
) -> tuple[FilterState, Updated, Tensor]:
    """Return the state given the row y (B, M), the update itself, and which rows the gate rejected."""
    prior, updated, size = state.belief, None, y.shape[-1]
    if form.read is not None and type(sensor.measurement) in READINGS and size <= prior.mean.shape[-1]:
        turned = nearest(sensor.measurement, y, prior.mean[:, :size])
        updated = form.read(prior, turned, weights, sensor.chol_r)
    if updated is None:
        images = _measured(sensor.measurement, draw(prior, weights), float(state.time))
        updated = form.update(prior, images, y, partial(residual, sensor.measurement), weights, sensor.chol_r)
    nothing_refuses = sensor.thresholds is None and weights.crowding is None
    if updated.sound and nothing_refuses and not bool(state.status.any()):
        return taken(state, updated), updated, torch.zeros_like(updated.singular)
    after, rejected = _decide(state, updated, y, sensor, weights, form)
    return after, updated, rejected


def propagate(flow: Flow, points: Tensor, dt: float) -> Tensor:
    """Return the points (B, S, D) after the flow, in one call on all of them."""
    flat = points.reshape(-1, points.shape[-1])
    propagated = flow(flat, dt)
    if not _is_real(propagated, flat.shape):
        message = (
            f"flow: expected flow(x, dt) to return a real tensor of the shape of x, {tuple(flat.shape)}; "
            f"received {described(propagated)}"
        )
        raise ValueError(message)
    return propagated.to(points.dtype).reshape(points.shape)


def _measured(measurement: Measurement, points: Tensor, t: float) -> Tensor:
    """Return the measurements (B, S, M) of the points (B, S, D) at time t."""
    images = measurement(points, t)
    expected = torch.Size((*points.shape[:-1], len(measurement.names)))
    if not _is_real(images, expected):
        message = (
            f"measurement: expected measurement(x, t) to return a real tensor {tuple(expected)} for x "
            f"{tuple(points.shape)} and the names {measurement.names}; received {described(images)}"
        )
        raise ValueError(message)
    return images.to(points.dtype)


def _is_real(value: object, shape: torch.Size) -> bool:
    return isinstance(value, Tensor) and value.shape == shape and not value.is_complex()


def _checked_prediction(state: FilterState) -> FilterState:
    """Give a status to members whose prediction is not finite, or has a variance of zero."""
    mean, chol = state.belief
    variance = chol.detach().square().sum(-1)
    smallest, largest = torch.aminmax(variance)
    # NaN is in both and fails both comparisons.
    if float(smallest) > 0.0 and float(largest) < torch.inf:
        return state
    finite = torch.isfinite(variance).all(-1) & torch.isfinite(mean).all(-1)
    state = fail(state, ~finite, Status.NOT_FINITE)
    return fail(state, (variance == 0.0).any(-1), Status.COLLAPSED)


def _not_mended(lost: Tensor, repairs: Tensor | None, weights: Weights) -> Tensor:
    """Return who lost digits, and not by negative weights: their repairs are counted and are no loss."""
    return lost if repairs is None or weights.downdate is None else lost & (repairs == 0)


def taken(state: FilterState, updated: Updated) -> FilterState:
    """Return the state after an update that every member takes: what `_decide` would return."""
    return state._replace(
        belief=updated.belief,
        rejections=torch.zeros_like(state.rejections),
        log_likelihood=state.log_likelihood + updated.log_likelihood,
    )


def _decide(
    state: FilterState,
    updated: Updated,
    y: Tensor,
    sensor: Sensor,
    weights: Weights,
    form: Form,
) -> tuple[FilterState, Tensor]:
    """Take or refuse the update, member by member; return also which rows the gate rejected, (B,) bool."""
    present = ~torch.isnan(y)
    has_row = present.any(-1)
    mean, chol = updated.belief
    # A sum of squares is finite where all of its terms are.
    sizes = chol.square().sum((-2, -1)) + mean.square().sum(-1) + updated.nis
    finite = torch.isfinite(sizes)
    if bool((has_row & (updated.singular | ~finite)).any()):
        state = fail(state, has_row & updated.singular, Status.COLLAPSED)
        state = fail(state, has_row & ~finite, Status.NOT_FINITE)
    accepted = has_row & state.alive
    rejected = torch.zeros_like(accepted)
    if sensor.thresholds is not None:
        rejected = accepted & (updated.nis > sensor.thresholds[present.sum(-1)])
        accepted = accepted & ~rejected
    lost = lost_in_update(state.belief, updated, y, sensor.chol_r, weights, squares=form.squares)
    state = fail(state, accepted & _not_mended(lost, updated.repairs, weights), Status.IMPRECISE)
    accepted = accepted & state.alive
    repairs = None if updated.repairs is None else updated.repairs * accepted
    state = add_repairs(state, repairs)
    state = state._replace(
        belief=choose(accepted, updated.belief, state.belief),
        rejections=torch.where(accepted, 0, state.rejections + rejected),
        log_likelihood=state.log_likelihood + torch.where(accepted, updated.log_likelihood, 0.0),
    )
    if sensor.thresholds is not None:
        state = fail(state, rejected & (state.rejections >= sensor.patience), Status.DIVERGED)
    return state, rejected
