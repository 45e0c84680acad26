"""The loop of a filter over time, with a model of its own in each step, and what is kept of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.state import FilterState, add_repairs
from ahnn.types import Flow
from ahnn_plugins.ukf import kernel
from ahnn_plugins.ukf.records import Step, collected
from ahnn_plugins.ukf.smoother import backward_kernel
from ahnn_plugins.ukf.steps import Grid
from ahnn_plugins.ukf.types import Backward, FilterResult, Form, Weights


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
    is_measured = (~torch.isnan(rows)).any(-1).any(0).tolist()
    after, steps = before, []
    for k, (length, time) in enumerate(zip(*grid, strict=True)):
        flow, chol_q, sensor = models(k)
        earlier = after.belief
        after, propagated = kernel.predict(after, flow, length, time, chol_q, weights, form)
        backward = None
        if smoothing:
            after, backward = _backward(after, earlier, propagated, chol_q, weights)
        predicted, updated, rejected = after.belief, None, None
        if is_measured[k]:
            after, updated, rejected = kernel.update(after, rows[:, k], sensor, weights, form)
        steps.append(Step(predicted, after.belief, updated, rejected, backward))
    return collected(steps, before, after, rows)


def _backward(
    state: FilterState, before: Belief, propagated: kernel.Propagated, chol_q: Tensor, weights: Weights
) -> tuple[FilterState, Backward]:
    """Return the law of the belief before a step given that after it, its repairs counted."""
    backward, mended = backward_kernel(propagated.points, before.chol, weights, chol_q)
    if mended is not None and propagated.repaired is not None:
        # The law holds the predicted covariance: what was mended there is no second repair.
        mended = mended & ~propagated.repaired
    return add_repairs(state, mended), backward
