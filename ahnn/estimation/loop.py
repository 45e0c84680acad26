"""Time loop of a filter with step-dependent models and records."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from ahnn.estimation import kernel as decisions
from ahnn.estimation.estimator import Kernel, SensorModel
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.state import FilterState, MemberState
from ahnn.estimation.step_noise import StepGrid
from ahnn.estimation.step_records import StepRecord, collected
from ahnn.types import Flow

M = TypeVar("M", bound=MemberState)


class StepModel(NamedTuple):
    """Models of one filter step.

    Attributes:
        flow: the process model.
        chol_q: (B, D, D) factor of the process noise covariance.
        sensor: measurement model of the row at the end of the step.
    """

    flow: Flow
    chol_q: Tensor
    sensor: SensorModel


class RunPlan(NamedTuple):
    """All steps of a run, for filters that look ahead.

    Attributes:
        rows: (B, T, M) measurements, NaN where a component is missing.
        grid: the T time steps.
        models: function that returns the models of step k, from 0; the same object for equal models.
        present: (B, T, M) bool, the components that are not missing.
        some: T flags, whether any component of any member is measured.
        whole: T flags, whether all components of all members are measured.
    """

    rows: Tensor
    grid: StepGrid
    models: Callable[[int], StepModel]
    present: Tensor
    some: list[bool]
    whole: list[bool]

    @classmethod
    def of(cls, rows: Tensor, grid: StepGrid, models: Callable[[int], StepModel]) -> RunPlan:
        """Return the plan of rows (B, T, M)."""
        missing = rows.isnan()
        present = ~missing
        if not bool(missing.any()):
            every = [True] * rows.shape[1]
            return cls(rows, grid, models, present, every, every)
        each = present.transpose(0, 1).flatten(1)
        return cls(rows, grid, models, present, each.any(1).tolist(), each.all(1).tolist())


class FilterLoop(Protocol[M]):
    """Step function of one run."""

    def __call__(
        self, k: int, state: M, row: Tensor | None, model: StepModel, length: float, time: Tensor
    ) -> tuple[M, StepRecord]:
        """Return the state after step k, which ends at `time`, and its record; the row may be None.

        A step function may also perform subsequent steps of its plan; the state is then the one after the
        last step of the record.
        """
        ...


def stepper(
    predict: Callable[..., tuple[M, Backward | None]],
    update: Callable[..., tuple[M, Updated, Tensor]],
    *,
    smoothing: bool,
) -> FilterLoop[M]:
    """Return the step function of `MemberFilter.predicted` and `updated`, or of functions like them."""

    def step(
        k: int,  # noqa: ARG001
        state: M,
        row: Tensor | None,
        model: StepModel,
        length: float,
        time: Tensor,
    ) -> tuple[M, StepRecord]:
        flow, chol_q, sensor = model
        before, backward = predict(state, flow, length, time, chol_q, smoothing=smoothing)
        after, updated, rejected = before, None, None
        if row is not None:
            after, updated, rejected = update(before, row, sensor)
        return after, StepRecord.of_one(before.belief, after.belief, updated, rejected, backward)

    return step


def kernel_stepper(kernel: Kernel, *, smoothing: bool) -> FilterLoop[FilterState]:
    """Return the step function of a kernel."""
    return stepper(partial(decisions.predict, kernel), partial(decisions.update, kernel), smoothing=smoothing)


def run(before: M, plan: RunPlan, step: FilterLoop[M]) -> FilterResult:
    """Filter the rows of a plan from a given state; arguments are already validated."""
    (lengths, times), after, records, k = plan.grid, before, list[StepRecord](), 0
    while k < len(lengths):
        row = plan.rows[:, k] if plan.some[k] else None
        after, record = step(k, after, row, plan.models(k), lengths[k], times[k])
        records.append(record)
        k += record.length
    return collected(records, before, after, plan.present, whole=all(plan.whole))
