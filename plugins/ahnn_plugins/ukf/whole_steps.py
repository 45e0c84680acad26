"""Fused filter steps in one library call, for steps without decisions.

If rows of the first state components are complete and accepted by all members, only flow, prediction,
posterior and sigma points are needed. The same functions are used as for single steps, so results are
bitwise identical.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.loop import RunPlan, StepModel, kernel_stepper
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_records import StepRecord
from ahnn.estimation.step_runs import StepRun
from ahnn_plugins.ukf.library_runs import done_steps, supported
from ahnn_plugins.ukf.unscented_kernel import SigmaPoints

FIRST, MOST = 32, 256
"""Minimum number of steps in the first library call, and maximum in any call."""
ROWS = 4096
"""Rows of all members in the first library call; each call without a decision doubles the steps."""


class WholeSteps:
    """Steps of one run, including those computed ahead.

    Args:
        plan: the run.
        kernel: kernel for the other steps.
        smoothing: whether to keep the laws of a smoother, which fused steps do not support.
    """

    def __init__(self, plan: RunPlan, kernel: SigmaPoints, *, smoothing: bool = False) -> None:
        weights, form, _ = kernel
        known = not smoothing and form.read is not None and weights.crowding is None
        self.possible = [known and (a or not b) for a, b in zip(plan.whole, plan.some, strict=True)]
        self.plan, self.kernel, self.smoothing = plan, kernel, smoothing
        self.rows = plan.rows.transpose(0, 1)
        self.ahead = min(MOST, max(FIRST, ROWS // len(plan.rows)))
        self.points: Tensor | None = None  # points after the flow of an incomplete step

    def __call__(
        self, k: int, state: FilterState, row: Tensor | None, model: StepModel, length: float, time: Tensor
    ) -> tuple[FilterState, StepRecord]:
        """Return the state after step k, or after several fused steps, and the record."""
        done = self.steps(k, state, model)
        if done is None:
            points, self.points = self.points, None
            single = kernel_stepper(self.kernel._replace(points=points), smoothing=self.smoothing)
            done = single(k, state, row, model, length, time)
        return done

    def steps(self, k: int, state: FilterState, model: StepModel) -> tuple[FilterState, StepRecord] | None:
        """Return the state after step k and the fused steps that follow it, and the record.

        Returns:
            None if the library does not support step k or cannot complete it.
        """
        given = self.kernel, model.sensor, model.chol_q, self.rows
        if not self.possible[k] or not supported(state, *given):
            return None
        lengths, times = self.plan.grid
        end, last, models = k + 1, min(k + self.ahead, len(lengths)), self.plan.models
        while end < last and self.possible[end] and models(end) is model:
            end += 1
        measured, rows = self.plan.whole[k:end], self.rows[k:end]
        rows = rows if all(measured) else rows[measured]
        starts = torch.cat((state.time[None], times[k : end - 1]))
        run = StepRun(
            starts, torch.tensor(lengths[k:end], dtype=torch.float64), model.chol_q[None], measured, rows
        )
        given = self.kernel.weights, model.flow, run, model.sensor
        count, results, self.points = done_steps(state, *given)
        if count == end - k:
            self.ahead = min(2 * self.ahead, MOST)
            return _recorded(state, results, measured, times[k + count - 1])
        self.ahead = max(1, count)
        if not count:
            return None
        done = tuple(part[:count] for part in results)
        return _recorded(state, done, measured[:count], times[k + count - 1])


def _recorded(
    state: FilterState, results: tuple[Tensor, ...], measured: list[bool], time: Tensor
) -> tuple[FilterState, StepRecord]:
    """Return the state after n steps, which end at `time`, and their record."""
    prior, prior_chol, innovation, mean, chol, _, nis, log_likelihoods, _ = results
    rejections, log_likelihood = state.rejections, state.log_likelihood
    if not all(measured):
        still = torch.tensor([not one for one in measured])
        mean[still], chol[still], innovation[still], nis[still] = (
            prior[still],
            prior_chol[still],
            torch.nan,
            torch.nan,
        )
        log_likelihoods = log_likelihoods[~still]
    if any(measured):
        rejections = torch.zeros_like(rejections)
        log_likelihood = torch.cat((log_likelihood[None], log_likelihoods)).cumsum(0)[-1]
    own = state.status, state.failed_step, rejections, state.repairs, log_likelihood
    after = FilterState(Belief(mean[-1], chol[-1]), time, state.steps + len(measured), *own)
    rejected = torch.zeros_like(nis, dtype=torch.bool)
    return after, StepRecord(Belief(prior, prior_chol), Belief(mean, chol), innovation, nis, rejected, None)
