"""Fused filter steps in one library call, for steps without decisions.

If complete rows of the first state components are measured and accepted by all members, only flow,
prediction, posterior and sigma points are needed. The same functions are used as for single steps: results
are bitwise identical.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.loop import RunPlan, StepModel, stepper
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_records import StepRecord
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.library_runs import RunSteps, done_steps, supported
from ahnn_plugins.ukf.unscented_kernel import SigmaPoints

FIRST, MOST = 16, 64
"""Steps of the first library call, and most steps of one; after a call without a decision twice as many."""


class WholeSteps:
    """Steps of one run, with those done ahead.

    Args:
        plan: the run.
        kernel: kernel for the other steps.
        smoothing: whether to keep the laws of a smoother, unsupported by fused steps.
    """

    def __init__(self, plan: RunPlan, kernel: SigmaPoints, *, smoothing: bool = False) -> None:
        weights, form, _ = kernel
        missing = torch.isnan(plan.rows).transpose(0, 1).flatten(1)
        self.whole, empty = (~missing.any(1)).tolist(), missing.all(1).tolist()
        known = not smoothing and form.read is not None and weights.crowding is None
        self.possible = [known and (a or b) for a, b in zip(self.whole, empty, strict=True)]
        self.plan, self.kernel, self.smoothing = plan, kernel, smoothing
        self.rows = plan.rows.transpose(0, 1)
        self.ahead = FIRST
        self.last: FilterState | None = None  # the state whose steps are known
        self.known: list[tuple[FilterState, StepRecord]] = []  # in reverse order
        self.points: Tensor | None = None  # after the flow of a step that is not whole

    def __call__(
        self, k: int, state: FilterState, row: Tensor | None, model: StepModel, length: float, time: Tensor
    ) -> tuple[FilterState, StepRecord]:
        """Return the state after step k, fused or not, and its record."""
        done = self.step(k, state, model)
        if done is None:
            points, self.points = self.points, None
            single = stepper(self.kernel._replace(points=points), smoothing=self.smoothing)
            done = single(k, state, row, model, length, time)
        return done

    def step(self, k: int, state: FilterState, model: StepModel) -> tuple[FilterState, StepRecord] | None:
        """Return the state after step k, and its record.

        Returns:
            None if the step is unsupported by the library, or some result is invalid.
        """
        if not self.possible[k]:
            return None
        if not (self.known and state is self.last):
            self.known = self._followed(k, state, model)
        if not self.known:
            return None
        done = self.known.pop()
        self.last = done[0]
        return done

    def _followed(self, k: int, state: FilterState, model: StepModel) -> list[tuple[FilterState, StepRecord]]:
        """Return the states and records of step k and those behind it that are whole, in reverse order."""
        lengths, times = self.plan.grid
        if not supported(state, self.kernel, model.sensor, model.chol_q, self.rows):
            return []
        end = k + 1
        while end < min(k + self.ahead, len(lengths)) and self.possible[end] and self._alike(end, model):
            end += 1
        measured = self.whole[k:end]
        starts, steps = [state.time, *times[k : end - 1]], torch.tensor(lengths[k:end], dtype=torch.float64)
        given = model.flow, starts, steps, model.chol_q[None], measured, self.rows[k:end][measured]
        count, results, self.points = done_steps(state, self.kernel.weights, RunSteps(*given, model.sensor))
        self.ahead = min(2 * self.ahead, MOST) if count == end - k else max(1, count)
        return _recorded(state, results, measured[:count], times[k : k + count])

    def _alike(self, k: int, model: StepModel) -> bool:
        """Return whether a step has the models of another."""
        other = self.plan.models(k)
        return all(a is b for a, b in zip(other, model, strict=True))


def _recorded(
    state: FilterState, results: tuple[Tensor, ...], measured: list[bool], times: list[Tensor]
) -> list[tuple[FilterState, StepRecord]]:
    """Return the states and records of steps, in reverse order."""
    rejected, nothing = torch.zeros_like(state.status, dtype=torch.bool), torch.zeros_like(state.rejections)
    counts = (state.steps + torch.arange(1, len(times) + 1, device=state.steps.device)).unbind()
    found = list[tuple[FilterState, StepRecord]]()
    parts = zip(counts, times, measured, *(part.unbind() for part in results), strict=False)
    for count, time, is_measured, mean, chol, *told in parts:
        predicted, updated = Belief(mean, chol), None
        belief, rejections, log_likelihood = predicted, state.rejections, state.log_likelihood
        if is_measured:
            updated = members.updated_of(tuple(told))
            belief, rejections = updated.belief, nothing
            log_likelihood = log_likelihood + updated.log_likelihood
        own = count, state.status, state.failed_step, rejections, state.repairs, log_likelihood
        state = FilterState(belief, time, *own)
        record = predicted, belief, updated, None if updated is None else rejected, None
        found.append((state, StepRecord(*record)))
    return found[::-1]
