"""The loop of a filter over time, with a model of its own in each step, and what is kept of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.state import FilterState, add_repairs
from ahnn.types import Flow
from ahnn_plugins.ukf import kernel
from ahnn_plugins.ukf.records import Step, collected
from ahnn_plugins.ukf.smoother import backward_kernel
from ahnn_plugins.ukf.steps import Grid
from ahnn_plugins.ukf.types import Backward, FilterResult, Form, Weights
from ahnn_plugins.ukf.whole_steps import WholeSteps


class StepModel(NamedTuple):
    """What a filter is told about one step.

    Attributes:
        flow: the process model.
        chol_q: (B, D, D) factor of the process noise.
        sensor: of the row at the end of the step.
    """

    flow: Flow
    chol_q: Tensor
    sensor: kernel.Sensor


def run(
    before: FilterState,
    rows: Tensor,
    grid: Grid,
    models: Callable[[int], StepModel],
    weights: Weights,
    form: Form,
    *,
    smoothing: bool,
) -> FilterResult:
    """Filter the rows (B, T, M) from a state on; arguments are checked.

    Args:
        before: the state at the start.
        rows: measurements, NaN where a component is missing.
        grid: T steps.
        models: gives the model of step k, from 0.
        weights: of the sigma points.
        form: of the covariances.
        smoothing: keep what `unscented_smoother` needs.
    """
    after, steps, whole = before, [], WholeSteps(rows, weights, form)
    for k, (length, time) in enumerate(zip(*grid, strict=True)):
        flow, chol_q, sensor = models(k)
        points = kernel.propagate(flow, whole.points(after), length)
        done = None if smoothing else whole.step(k, after, points, time, chol_q, sensor)
        if done is None:
            row = None if whole.empty[k] else rows[:, k]
            done = _step(row, after, points, time, chol_q, sensor, weights, form, smoothing=smoothing)
        after, step = done
        steps.append(step)
    return collected(steps, before, after, rows)


def _step(
    row: Tensor | None,
    state: FilterState,
    points: Tensor,
    time: Tensor,
    chol_q: Tensor,
    sensor: kernel.Sensor,
    weights: Weights,
    form: Form,
    *,
    smoothing: bool,
) -> tuple[FilterState, Step]:
    """Return the state after a step in which anything may happen to a member, and its record."""
    after, propagated = kernel.predict_from(points, state, time, chol_q, weights, form)
    backward = updated = rejected = None
    if smoothing:
        after, backward = _backward(after, state.belief, propagated, chol_q, weights)
    predicted = after.belief
    if row is not None:
        after, updated, rejected = kernel.update(after, row, sensor, weights, form)
    return after, Step(predicted, after.belief, updated, rejected, backward)


def _backward(
    state: FilterState, before: Belief, propagated: kernel.Propagated, chol_q: Tensor, weights: Weights
) -> tuple[FilterState, Backward]:
    """Return the law of the belief before a step given that after it, its repairs counted."""
    backward, mended = backward_kernel(propagated.points, before.chol, weights, chol_q)
    if mended is not None and propagated.repaired is not None:
        # The law holds the predicted covariance: what was mended there is no second repair.
        mended = mended & ~propagated.repaired
    return add_repairs(state, mended), backward
