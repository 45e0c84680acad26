"""Gaussian filters built from a kernel, for single steps or batches of rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

from torch import Tensor

from ahnn.estimation import kernel as decisions
from ahnn.estimation.belief import Belief
from ahnn.estimation.estimator import Batch, Kernel, SensorModel, Smoothed
from ahnn.estimation.loop import FilterLoop, RunPlan, kernel_stepper
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.smoother import smoother
from ahnn.estimation.state import FilterState, MemberState, initial_state
from ahnn.types import Flow


class GaussianFilter(MemberFilter[FilterState]):
    """Filter of Gaussian beliefs defined by its kernel; subclasses are dataclasses."""

    carried: ClassVar[type[MemberState]] = FilterState

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Rauch-Tung-Striebel smoother."""
        return {"smoothed": lambda result, _: Smoothed(smoother(result))}

    @abstractmethod
    def kernel(self, belief: Belief) -> Kernel:
        """Return the kernel for beliefs of this shape, on this device."""

    def stepper(self, kernel: Kernel, plan: RunPlan, *, smoothing: bool) -> FilterLoop[FilterState]:
        """Return the step function of a run for a kernel."""
        return kernel_stepper(kernel, smoothing=smoothing)

    def steps(self, state: FilterState, plan: RunPlan, *, smoothing: bool) -> FilterLoop[FilterState]:
        """Return the step function of a run, with the same kernel in all steps."""
        return self.stepper(self.kernel(state.belief), plan, smoothing=smoothing)

    def initial(self, belief: Belief, time: float) -> FilterState:
        """Return the state of a belief; raises ValueError for invalid kernel constants."""
        state = initial_state(belief, time)
        self.kernel(belief)
        return state

    def predicted(
        self,
        state: FilterState,
        flow: Flow,
        dt: float,
        time: Tensor,
        chol_q: Tensor,
        *,
        smoothing: bool = False,
    ) -> tuple[FilterState, Backward | None]:
        """Propagate the state over a step ending at `time`; optionally return the backward law."""
        kernel = self.kernel(state.belief)
        return decisions.predict(kernel, state, flow, dt, time, chol_q, smoothing=smoothing)

    def updated(
        self, state: FilterState, y: Tensor, sensor: SensorModel
    ) -> tuple[FilterState, Updated, Tensor]:
        """Condition the state on a row (B, M); return state, update, and gate rejections, (B,) bool."""
        return decisions.update(self.kernel(state.belief), state, y, sensor)
