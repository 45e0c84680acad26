"""Interacting multiple models (Blom & Bar-Shalom 1988; Bar-Shalom, Li & Kirubarajan 2001, section 11.6.6).

The motion switches between modes according to a Markov chain. Each mode has a belief and a probability.
Before a step the beliefs are mixed: the belief of mode j takes the mean and covariance of the mixture of all
beliefs, weighted by the probabilities of a transition to mode j. Each is then predicted and updated by a
Gaussian filter with the process noise, and optionally the flow, of its mode; modes are weighted by the
likelihood of the measurement. The reported belief consists of the moments of the mixture, which also define
innovation, NIS and gate; the log-likelihood refers to the mixture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import torch
from torch import Tensor

from ahnn.arguments import check_arguments
from ahnn.dynamics.flow_at_time import at
from ahnn.errors import UserError
from ahnn.estimation.belief import Belief, Status
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.gate import Gate
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.kernel import checked_prediction, decided
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.results import Backward, Updated
from ahnn.estimation.rounding import lost_in_prediction
from ahnn.estimation.state import MemberState, add_repairs, fail, frozen
from ahnn.types import Flow
from ahnn_plugins.imm.mixture import MixtureState, mixing, mixture_moments, stacked
from ahnn_plugins.imm.motion_mode import MotionMode

QUIET_AND_NOISY = (MotionMode(), MotionMode(factor=10.0))


@final
@dataclass(frozen=True)
class InteractingModels(MemberFilter[MixtureState]):
    """Interacting multiple models for a batch of B members, each with K beliefs.

    Attributes:
        filter: Gaussian filter of the modes; its gate is ignored.
        modes: two or more modes, each a `MotionMode` or its attributes.
        dwell: mean duration of a mode, common or per mode, in the unit of time.
        gate: gate for improbable measurement rows, or None.

    Raises:
        UserError: `filter` is not a Gaussian filter, fewer than two modes, or invalid times.
    """

    carried: ClassVar[type[MemberState]] = MixtureState
    filter: GaussianFilter
    modes: tuple[MotionMode | dict[str, Any], ...] = QUIET_AND_NOISY
    dwell: float | tuple[float, ...] = 1000.0
    gate: Gate | None = None

    def __post_init__(self) -> None:
        """Check that values are within their limits."""
        super().__post_init__()
        if not isinstance(self.filter, GaussianFilter):
            message = f"filter: expected a Gaussian filter, such as ukf or ekf; received {self.filter!r}"
            raise UserError(message)
        if len(self.modes) < 2:
            message = f"modes: expected at least two; received {len(self.modes)}"
            raise UserError(message)
        object.__setattr__(self, "modes", tuple(_mode(given, k) for k, given in enumerate(self.modes)))
        given = self.dwell
        times = (given,) * len(self.modes) if isinstance(given, int | float) else tuple(given)
        numbers = all(isinstance(time, int | float) and 0.0 < time < torch.inf for time in times)
        if len(times) != len(self.modes) or not numbers:
            message = f"dwell: expected a time > 0, or {len(self.modes)} times; received {given!r}"
            raise UserError(message)
        object.__setattr__(self, "dwell", times)

    @property
    def name(self) -> str:
        """Name in tables."""
        return "imm"

    @property
    def definite(self) -> bool:
        """Whether the filters of the modes require definite measurement noise."""
        return self.filter.definite

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        inner = {key: value for key, value in self.filter.about.items() if key != "gate"}
        own = {"filter": {"is": self.filter.name, **inner}, "dwell": self.dwell}
        return {**super().about, **own, "modes": [mode.about for mode in self._modes]}

    @property
    def _modes(self) -> tuple[MotionMode, ...]:
        return self.modes  # pyright: ignore[reportReturnType] - built from attributes above

    def initial(self, belief: Belief, time: float) -> MixtureState:
        """Return the state of a belief, with stationary mode probabilities.

        Raises:
            UserError: modes incompatible with states of this size.
        """
        for k, mode in enumerate(self._modes):
            mode.require_size(belief.mean.shape[-1], f"modes.{k}")
        kept, count = self.filter.initial(belief, time), len(self._modes)
        dwell = torch.tensor(self.dwell, dtype=torch.float64, device=belief.mean.device)
        log_modes = (dwell / dwell.sum()).log().expand(len(belief.mean), count).clone()
        return MixtureState(*kept, *stacked(belief, count), log_modes)

    def predicted(
        self,
        state: MixtureState,
        flow: Flow,
        dt: float,
        time: Tensor,
        chol_q: Tensor,
        *,
        smoothing: bool = False,
    ) -> tuple[MixtureState, Backward | None]:
        """Propagate the state over a step ending at `time`; there is no backward law."""
        dwell = torch.tensor(self.dwell, dtype=torch.float64, device=chol_q.device)
        step, kernel = mixing(state.log_modes, dwell, dt), self.filter.kernel(state.belief)
        after, moved = state._replace(time=time, steps=state.steps + 1), []
        for mode, origins in zip(self._modes, step.origins.unbind(1), strict=True):
            before = mixture_moments(state.mode_means, state.mode_chols, origins)
            here = at(mode.own_flow(flow), state.time)
            found = kernel.predict(before, here, dt, mode.noise(chol_q, dt))
            lost = lost_in_prediction(before, found.belief, found.repaired, kernel.rounding)
            after = add_repairs(after, found.repaired)
            after = after if lost is None else fail(after, lost, Status.IMPRECISE)
            moved.append(found.belief)
        after = checked_prediction(after.mixed(moved, step.log_modes))
        return frozen(after, state), None

    def updated(
        self, state: MixtureState, y: Tensor, sensor: SensorModel
    ) -> tuple[MixtureState, Updated, Tensor]:
        """Condition the state on a row (B, M); return state, update, and gate rejections, (B,) bool."""
        kernel, time = self.filter.kernel(state.belief), float(state.time)
        found = [kernel.update(belief, y, sensor, time) for belief in state.beliefs]
        weighed = state.log_modes + torch.stack([one.log_likelihood for one in found], 1)
        total = weighed.logsumexp(-1)
        proposed = state.mixed([one.belief for one in found], weighed - total.unsqueeze(-1))
        of_moments = kernel.update(state.belief, y, sensor, time)
        innovation = of_moments._replace(
            belief=proposed.belief,
            log_likelihood=total,
            singular=torch.stack([one.singular for one in found]).any(0),
            repairs=_sum([one.repairs for one in found]),
            sound=False,
        )
        after, accepted, rejected = decided(state, innovation, y, sensor, kernel.rounding)
        return after.where(~accepted, proposed), innovation, rejected


def _sum(counts: list[Tensor | None]) -> Tensor | None:
    """Return sums (B,) of counts, with None as zeros; None if all are None."""
    there = [count for count in counts if count is not None]
    return torch.stack(there).sum(0) if there else None


def _mode(given: MotionMode | dict[str, Any], number: int) -> MotionMode:
    if isinstance(given, MotionMode):
        return given
    check_arguments(f"modes.{number}", MotionMode, given)
    return MotionMode(**given)
