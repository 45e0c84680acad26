"""Iterated smoother: the model is linearised about the smoothed beliefs instead of the filtered ones.

Iterated posterior linearisation (Garcia-Fernandez, Svensson & Särkkä 2017): flow and measurements are
replaced by their statistical linear regressions over the last smoothed beliefs, their residual covariance is
added to the noise, and the Kalman smoother of the affine model gives the next beliefs. A smoother linearised
once, over a wide early belief, is overconfident there; at the fixed point every regression is over a belief
given all measurements. On a linear system the first iteration is exact and changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.argument_checks import checked_rows, checked_sensor
from ahnn.estimation.belief import Belief, Status, choose
from ahnn.estimation.consistency import deviations
from ahnn.estimation.loop import RunPlan, StepModel, kernel_stepper, run
from ahnn.estimation.results import FilterResult, ProcessNoise, SmootherResult
from ahnn.estimation.state import initial_state
from ahnn.estimation.step_noise import StepGrid, process_factor
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow
from ahnn_plugins.ukf.parameters import UnscentedParameters
from ahnn_plugins.ukf.regression import linear_flow, linear_sensor, regression_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.unscented_kernel import SigmaPoints
from ahnn_plugins.ukf.unscented_smoother import unscented_smoother

SETTLED = 1e-2
"""Change of a mean, in standard deviations, below which the iteration has converged."""


class Iterated(NamedTuple):
    """Result of `iterated_smoother`.

    Attributes:
        smoothed: smoothed beliefs; for a member that failed in an iteration, the last valid ones.
        change: (B,) largest change of a mean in the last iteration, in standard deviations; inf for members
            that failed.
        iterations: number of iterations.
    """

    smoothed: SmootherResult
    change: Tensor
    iterations: int

    @property
    def settled(self) -> Tensor:
        """(B,) bool, whether the iteration converged."""
        return self.change <= SETTLED


@torch.no_grad()
def iterated_smoother(
    result: FilterResult,
    flow: Flow,
    measurements: Numbers,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Numbers,
    dt: Numbers,
    *,
    parameters: UnscentedParameters | None = None,
    start_time: float = 0.0,
    iterations: int = 10,
) -> Iterated:
    """Compute the beliefs given all measurements, relinearised until convergence.

    Args:
        result: result of `unscented_filter` from a belief with `smoothing=True`, the initial iterate. Rows
            rejected by its gate stay rejected.
        flow: process model; this and the following arguments are those of the filter.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: measurement model.
        process_noise: covariance Q of one step, or a function of its length.
        measurement_noise: covariance R.
        dt: length of every step, or (T,) lengths.
        parameters: sigma point parameters of the regressions; None for the defaults.
        start_time: time of the initial belief.
        iterations: maximum number of iterations.

    Raises:
        ValueError: no backward kernels in the result, arguments invalid for the filter, or parameters with
            negative weights.
    """
    guess = unscented_smoother(result)
    there = (result.status == Status.OK).nonzero().flatten()
    size, device = result.means.shape[-1], result.means.device
    weights = regression_weights(parameters or UnscentedParameters(), size, device)
    sensor = checked_sensor(measurement, measurement_noise, result.initial, None)
    sensor = sensor._replace(chol_r=sensor.chol_r[there])
    batch, steps = result.means.shape[:2]
    rows = checked_rows(measurements, "measurements", (batch, steps, len(measurement.names)), device)
    rows = rows.masked_fill(result.rejected.unsqueeze(-1), torch.nan)[there]
    begin = initial_state(_members(result.initial, there), start_time)
    grid, chol_q = StepGrid.of(dt, steps, begin.time), process_factor(process_noise, result.initial)

    def relinearised(about: SmootherResult) -> SmootherResult:
        def line(k: int) -> StepModel:
            length = grid.lengths[k]
            here = at(flow, float(grid.times[k]) - length)
            step = linear_flow(here, length, _belief(about, k), weights, chol_q(length)[there])
            return StepModel(
                *step, linear_sensor(sensor, float(grid.times[k]), _belief(about, k + 1), weights)
            )

        step = kernel_stepper(SigmaPoints(weights, SQUARE_ROOT), smoothing=True)
        return unscented_smoother(run(begin, RunPlan.of(rows, grid, line), step))

    current, change, count = _settled(_of(guess, there), relinearised, iterations)
    lost = change.new_full((batch,), torch.inf)
    return Iterated(_spread(current, there, guess), lost.index_copy(0, there, change), count)


def _settled(
    current: SmootherResult, relinearised: Callable[[SmootherResult], SmootherResult], iterations: int
) -> tuple[SmootherResult, Tensor, int]:
    """Iterate until convergence; return the result, the last change (B,), and the number of iterations."""
    change, count = torch.full_like(current.means[:, 0, 0], 2 * SETTLED), 0
    while count < iterations and bool(((change > SETTLED) & change.isfinite()).any()):
        new, count = relinearised(current), count + 1
        change = torch.where(change.isfinite(), _change(current, new), torch.inf)
        current = _chosen(change.isfinite(), new, current)
    return current, change, count


def _change(old: SmootherResult, new: SmootherResult) -> Tensor:
    """Return the largest change of a mean, (B,), in its standard deviations; inf for failed members."""
    start = (new.initial.mean - old.initial.mean) / deviations(new.initial.chol)
    later = (new.means - old.means) / deviations(new.chols)
    change = torch.cat((start.unsqueeze(1), later), dim=1).abs().amax((1, 2))
    return torch.where(new.status == Status.OK, change, torch.inf).nan_to_num(nan=torch.inf)


def _belief(smoothed: SmootherResult, k: int) -> Belief:
    """Return the belief before step k."""
    return Belief(smoothed.means[:, k - 1], smoothed.chols[:, k - 1]) if k else smoothed.initial


def _members(belief: Belief, rows: Tensor) -> Belief:
    return Belief(belief.mean[rows], belief.chol[rows])


def _of(smoothed: SmootherResult, rows: Tensor) -> SmootherResult:
    """Return the smoothed beliefs of selected members."""
    initial, *others = smoothed
    return SmootherResult(_members(initial, rows), *(part[rows] for part in others))


def _chosen(better: Tensor, yes: SmootherResult, no: SmootherResult) -> SmootherResult:
    """Select moments per member according to `better`, (B,) bool; status and repairs are taken from `no`."""
    column = better[:, None, None]
    return no._replace(
        initial=choose(better, yes.initial, no.initial),
        means=torch.where(column, yes.means, no.means),
        chols=torch.where(column.unsqueeze(-1), yes.chols, no.chols),
    )


def _spread(part: SmootherResult, rows: Tensor, whole: SmootherResult) -> SmootherResult:
    """Return the moments of all members, with those of the members `rows` replaced."""
    initial = Belief(*(w.index_copy(0, rows, p) for w, p in zip(whole.initial, part.initial, strict=True)))
    means, chols = whole.means.index_copy(0, rows, part.means), whole.chols.index_copy(0, rows, part.chols)
    return whole._replace(initial=initial, means=means, chols=chols)
