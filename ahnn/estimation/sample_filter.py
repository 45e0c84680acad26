"""Filters whose belief is a set of samples, with one flow call for all members.

A sample filter defines how samples are drawn from a belief, propagated over a step, and moved or weighted by
a measurement. Arguments, gating, status and freezing of members are common to all filters, see
`ahnn.estimation.member_filter`; other modules use the moments of the samples.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.errors import UserError
from ahnn.estimation.belief import Belief, choose
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.kernel import checked_prediction, decided, measured, propagate
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.random_numbers import RandomNumbers
from ahnn.estimation.results import Backward, Updated
from ahnn.estimation.rounding import Rounding
from ahnn.estimation.samples import SampleState
from ahnn.estimation.state import MemberState, frozen, initial_state
from ahnn.measurements import residual
from ahnn.types import Flow

LARGEST_SEED = 2**63 - 1


class SampleFilter(MemberFilter[SampleState]):
    """Filter with N samples for each of B members; subclasses are dataclasses.

    Attributes:
        seed: random seed; equal seeds give bit-identical estimates.
    """

    carried: ClassVar[type[MemberState]] = SampleState
    seed: int

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid gate or seed."""
        super().__post_init__()
        if not isinstance(self.seed, int) or not 0 <= self.seed <= LARGEST_SEED:
            message = f"seed: expected a whole number from 0 to 2^63 - 1; received {self.seed!r}"
            raise UserError(message)

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of samples N."""

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        return {**super().about, "samples": self.count, "seed": self.seed}

    @abstractmethod
    def drawn(self, belief: Belief, random: RandomNumbers) -> Tensor:
        """Draw samples (B, N, D) from a belief."""

    @abstractmethod
    def moments(self, points: Tensor, log_weights: Tensor) -> Belief:
        """Return the moments of samples (B, N, D) with weights (B, N)."""

    @abstractmethod
    def noise(self, draw: Tensor, points: Tensor) -> Tensor:
        """Return numbers (B, N, D), from a normal draw, that are added to samples times a factor of Q."""

    def followed(self, state: SampleState, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return propagated samples (B, N, D) and log weights (B, N), given the images of the samples."""
        return images, state.log_weights

    def law(self, before: Tensor, images: Tensor, chol_q: Tensor) -> Backward | None:
        """Return the backward law from samples and images (B, N, D), with Q added; None if unsupported."""

    @abstractmethod
    def conditioned(
        self, state: SampleState, images: Tensor, y: Tensor, sensor: SensorModel
    ) -> tuple[SampleState, Updated]:
        """Condition samples on a row y (B, M), NaN where missing; return the state and the update.

        Args:
            state: state before the update; its `random` belongs to the update.
            images: (B, N, M) predicted measurements of the samples.
            y: measurement row.
            sensor: measurement model of the row.
        """

    def initial(self, belief: Belief, time: float) -> SampleState:
        """Return the state of a belief; raises ValueError for an unsuitable number of samples."""
        kept, like = initial_state(belief, time), belief.mean
        seed = torch.tensor(self.seed, dtype=torch.int64, device=like.device)
        points = self.drawn(belief, RandomNumbers(self.seed, 0, 0))
        weights = like.new_full((len(like), self.count), -math.log(self.count))
        moments = self.moments(points, weights)
        return SampleState(moments, *kept[1:], points, weights, seed, torch.zeros_like(kept.steps))

    def predicted(
        self,
        state: SampleState,
        flow: Flow,
        dt: float,
        time: Tensor,
        chol_q: Tensor,
        *,
        smoothing: bool = False,
    ) -> tuple[SampleState, Backward | None]:
        """Propagate the state over a step ending at `time`; optionally return the backward law."""
        images = propagate(at(flow, state.time), state.points, dt)
        steps = state.steps + 1
        after = state._replace(time=time, steps=steps, updates=torch.zeros_like(state.updates))
        points, weights = self.followed(state, images)
        if bool(chol_q.any()):
            draw = after.random.normal(points, *points.shape)
            points = points + self.noise(draw, points) @ chol_q.mT
        belief = self.moments(points, weights)
        after = checked_prediction(after._replace(belief=belief, points=points, log_weights=weights))
        return frozen(after, state), self.law(state.points, images, chol_q) if smoothing else None

    def updated(
        self, state: SampleState, y: Tensor, sensor: SensorModel
    ) -> tuple[SampleState, Updated, Tensor]:
        """Condition the state on a row (B, M); return state, update, and gate rejections, (B,) bool."""
        state = state._replace(updates=state.updates + 1)
        images = measured(sensor.measurement, state.points, float(state.time))
        proposed, update = self.conditioned(state, images, y, sensor)
        if sensor.thresholds is not None:  # a rejected row may leave all samples with zero weight
            refused = update.nis > sensor.thresholds[(~y.isnan()).sum(-1)]
            belief = choose(refused, state.belief, update.belief)
            update = update._replace(belief=belief, singular=update.singular & ~refused)
        after, accepted, rejected = decided(state, update, y, sensor, Rounding())
        return after.where(~accepted, proposed), update, rejected


def image_deviations(
    images: Tensor, weights: Tensor | float, y: Tensor, sensor: SensorModel
) -> tuple[Tensor, Tensor]:
    """Return deviations (B, N, M) of measured samples from their mean, and the innovation (B, M).

    Both are 0 where a component is missing; angles are averaged near the first sample's angle.

    Args:
        images: (B, N, M) predicted measurements of samples.
        weights: (B, N, 1) weights that sum to 1, or their common value.
        y: (B, M), NaN where missing.
        sensor: measurement model, which defines differences.
    """
    model, present = sensor.measurement, ~torch.isnan(y)
    outer = residual(model, images, images[:, :1].expand_as(images))
    outer = torch.where(present.unsqueeze(1), outer, 0.0)
    shift = (weights * outer).sum(1)
    y_pred = images[:, 0] + shift
    # Missing components are filled in, since a residual may mix components.
    innovation = residual(model, torch.where(present, y, y_pred), y_pred)
    return outer - shift.unsqueeze(1), torch.where(present, innovation, 0.0)
