"""Iterated smoother: the model is linearised about the smoothed beliefs, not about those of the filter.

Iterated posterior linearisation (Garcia-Fernandez, Svensson & Särkkä 2017): flow and measurements are
replaced by their statistical linear regressions over the last smoothed beliefs, what these leave counts as
noise, and the Kalman smoother of the affine model gives the next ones. A smoother that is linearised once,
over a wide early belief, is overconfident there; at the fixed point every regression is over a belief that
knows all measurements. On a linear system the first iteration is exact and changes nothing.
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
from ahnn.estimation.loop import StepModel, run, stepper
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
"""Largest change of a mean, in its standard deviations, that is none."""


class Iterated(NamedTuple):
    """What `iterated_smoother` returns.

    Attributes:
        smoothed: the beliefs; of a member that an iteration lost, the last sound ones.
        change: (B,) largest change of a mean in the last iteration, in standard deviations; inf of members
            that the filter or an iteration has lost.
        iterations: that were made.
    """

    smoothed: SmootherResult
    change: Tensor
    iterations: int

    @property
    def settled(self) -> Tensor:
        """(B,) bool, whether the last iteration changed nothing."""
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
    """Return the beliefs given all measurements, relinearised until they settle.

    Args:
        result: of `unscented_filter` with `smoothing=True` from a belief, where the iterations begin. Rows
            that its gate refused stay refused.
        flow: the process model; this and what follows as the filter had it.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: the model of the measurements.
        process_noise: Q of one step, or a function of its length.
        measurement_noise: R.
        dt: length of every step, or (T,) lengths.
        parameters: of the sigma points of the regressions; None takes the defaults.
        start_time: time of the initial belief.
        iterations: at most.

    Raises:
        ValueError: no backward kernels in the result, other arguments than the filter takes, or parameters
            that leave negative weights.
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

        step = stepper(SigmaPoints(weights, SQUARE_ROOT), smoothing=True)
        return unscented_smoother(run(begin, rows, grid, line, step))

    current, change, count = _settled(_of(guess, there), relinearised, iterations)
    lost = change.new_full((batch,), torch.inf)
    return Iterated(_spread(current, there, guess), lost.index_copy(0, there, change), count)


def _settled(
    current: SmootherResult, relinearised: Callable[[SmootherResult], SmootherResult], iterations: int
) -> tuple[SmootherResult, Tensor, int]:
    """Iterate until nothing changes; return what there is, the last change (B,), and how many it were."""
    change, count = torch.full_like(current.means[:, 0, 0], 2 * SETTLED), 0
    while count < iterations and bool(((change > SETTLED) & change.isfinite()).any()):
        new, count = relinearised(current), count + 1
        change = torch.where(change.isfinite(), _change(current, new), torch.inf)
        current = _chosen(change.isfinite(), new, current)
    return current, change, count


def _change(old: SmootherResult, new: SmootherResult) -> Tensor:
    """Return the largest change of a mean, (B,), in its standard deviations; inf of members that are lost."""
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
    """Return what is smoothed of some of the members."""
    initial, *others = smoothed
    return SmootherResult(_members(initial, rows), *(part[rows] for part in others))


def _chosen(better: Tensor, yes: SmootherResult, no: SmootherResult) -> SmootherResult:
    """Return moments picked member by member, better (B,) bool; status and repairs are those of `no`."""
    column = better[:, None, None]
    return no._replace(
        initial=choose(better, yes.initial, no.initial),
        means=torch.where(column, yes.means, no.means),
        chols=torch.where(column.unsqueeze(-1), yes.chols, no.chols),
    )


def _spread(part: SmootherResult, rows: Tensor, whole: SmootherResult) -> SmootherResult:
    """Return the moments of all members, those of some of them replaced."""
    initial = Belief(*(w.index_copy(0, rows, p) for w, p in zip(whole.initial, part.initial, strict=True)))
    means, chols = whole.means.index_copy(0, rows, part.means), whole.chols.index_copy(0, rows, part.chols)
    return whole._replace(initial=initial, means=means, chols=chols)
