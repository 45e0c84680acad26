"""Prediction and update of a Gaussian filter: the kernel's proposal, accepted or rejected per member.

A failed member receives a status and is frozen, see `ahnn.estimation.state`. Arguments are already validated.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.belief import Status
from ahnn.estimation.estimator import Kernel, SensorModel
from ahnn.estimation.results import Backward, Updated
from ahnn.estimation.rounding import Rounding, lost_in_prediction, lost_in_update
from ahnn.estimation.state import FilterState, Kept, add_repairs, fail, frozen
from ahnn.measurements import Measurement
from ahnn.numbers import described
from ahnn.types import Flow


def predict(
    kernel: Kernel,
    state: FilterState,
    flow: Flow,
    dt: float,
    time: Tensor,
    chol_q: Tensor,
    *,
    smoothing: bool = False,
) -> tuple[FilterState, Backward | None]:
    """Propagate the state over a step ending at `time`; optionally return the backward law."""
    predicted = kernel.predict(state.belief, at(flow, state.time), dt, chol_q, smoothing=smoothing)
    after = FilterState(predicted.belief, time, state.steps + 1, *state[3:])
    after = add_repairs(after, predicted.repaired)
    if not predicted.sound:
        after = checked_prediction(after)
    lost = lost_in_prediction(state.belief, predicted.belief, predicted.repaired, kernel.rounding)
    if lost is not None:
        after = fail(after, lost, Status.IMPRECISE)
    return add_repairs(frozen(after, state), predicted.mended), predicted.backward


def update(
    kernel: Kernel, state: FilterState, y: Tensor, sensor: SensorModel
) -> tuple[FilterState, Updated, Tensor]:
    """Condition the state on the row y (B, M); return state, update, and gate rejections."""
    updated, rounding = kernel.update(state.belief, y, sensor, float(state.time)), kernel.rounding
    nothing_refuses = rounding.crowding is None and not bool(state.status.any())
    if updated.sound and nothing_refuses and _within_gate(updated, sensor):
        return taken(state, updated), updated, torch.zeros_like(updated.singular)
    after, accepted, rejected = decided(state, updated, y, sensor, rounding)
    return after.where(~accepted, state._replace(belief=updated.belief)), updated, rejected


def _within_gate(updated: Updated, sensor: SensorModel) -> bool:
    """Return whether every NIS is within the smallest threshold of the gate, that of a single component."""
    return sensor.thresholds is None or bool((updated.nis <= sensor.thresholds[1]).all())


def propagate(flow: Flow, points: Tensor, dt: float) -> Tensor:
    """Propagate points (B, S, D) by a single call of the flow.

    Raises:
        ValueError: the flow returns a wrong shape or complex numbers.
    """
    flat = points.reshape(-1, points.shape[-1])
    propagated = flow(flat, dt)
    require_states(propagated, flat.shape)
    return propagated.to(points.dtype).reshape(points.shape)


def require_states(propagated: object, shape: torch.Size) -> None:
    """Raise ValueError if a flow returns anything but real states with the shape of its input."""
    if not _is_real(propagated, shape):
        message = (
            f"flow: expected flow(x, dt) to return a real tensor with the shape of x, {tuple(shape)}; "
            f"received {described(propagated)}"
        )
        raise ValueError(message)


def measured(measurement: Measurement, points: Tensor, t: float) -> Tensor:
    """Return the measurements (B, S, M) of the points (B, S, D) at time t.

    Raises:
        ValueError: the model returns a wrong shape or complex numbers.
    """
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


def checked_prediction(state: Kept) -> Kept:
    """Assign a status to members whose prediction is not finite or has zero variance."""
    mean, chol = state.belief
    variance = chol.detach().square().sum(-1)
    smallest, largest = torch.aminmax(variance)
    # NaN propagates into both results and fails both comparisons.
    if float(smallest) > 0.0 and float(largest) < torch.inf:
        return state
    finite = torch.isfinite(variance).all(-1) & torch.isfinite(mean).all(-1)
    state = fail(state, ~finite, Status.NOT_FINITE)
    return fail(state, (variance == 0.0).any(-1), Status.COLLAPSED)


def taken(state: FilterState, updated: Updated) -> FilterState:
    """Return the state after an update that every member accepts; equal to the result of `decided`."""
    return state._replace(
        belief=updated.belief,
        rejections=torch.zeros_like(state.rejections),
        log_likelihood=state.log_likelihood + updated.log_likelihood,
    )


def decided(
    state: Kept, updated: Updated, y: Tensor, sensor: SensorModel, rounding: Rounding
) -> tuple[Kept, Tensor, Tensor]:
    """Accept or reject an update, member by member.

    Returns:
        The state with the estimates before the update, the mask of members that accept it, and the mask
        of rows rejected by the gate, (B,) bool each.
    """
    present = ~torch.isnan(y)
    has_row = present.any(-1)
    mean, chol = updated.belief
    # A sum of squares is finite if and only if all terms are.
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
    lost = lost_in_update(state.belief, updated, y, sensor.chol_r, rounding)
    state = fail(state, accepted & lost, Status.IMPRECISE)
    accepted = accepted & state.alive
    repairs = None if updated.repairs is None else updated.repairs * accepted
    state = add_repairs(state, repairs)
    state = state._replace(
        rejections=torch.where(accepted, 0, state.rejections + rejected),
        log_likelihood=state.log_likelihood + torch.where(accepted, updated.log_likelihood, 0.0),
    )
    if sensor.thresholds is not None:
        state = fail(state, rejected & (state.rejections >= sensor.patience), Status.DIVERGED)
    return state, accepted, rejected
