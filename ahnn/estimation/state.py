"""State of a recursive estimator between calls, and bookkeeping of its members.

A failed member is frozen: it stays in the batch with its last valid belief, so that tensor shapes do not
change and the other members stay bit-identical.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, Self, TypeVar

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose, leading


class EstimatorState(Protocol):
    """Estimator state of B members: a NamedTuple of tensors and of NamedTuples of tensors."""

    @property
    def time(self) -> Tensor:
        """() float64, time of the state."""
        ...

    @property
    def status(self) -> Tensor:
        """(B,) int64, see `Status`."""
        ...

    @property
    def moments(self) -> Belief:
        """Mean (B, D) and factor of the covariance (B, D, D)."""
        ...

    def _replace(self, **parts: Any) -> Self: ...


class MemberState(EstimatorState, Protocol):
    """State with member statuses, of Gaussian and sample filters; see `FilterState`."""

    @property
    def belief(self) -> Belief:
        """Moments as a belief."""
        ...

    @property
    def steps(self) -> Tensor:
        """() int64, number of predictions so far."""
        ...

    @property
    def failed_step(self) -> Tensor:
        """(B,) int64, the prediction at which the member failed."""
        ...

    @property
    def rejections(self) -> Tensor:
        """(B,) int64, consecutive rows rejected by the gate."""
        ...

    @property
    def repairs(self) -> Tensor:
        """(B,) int64, number of repaired covariances."""
        ...

    @property
    def log_likelihood(self) -> Tensor:
        """(B,) float64, log-likelihood of the accepted measurements."""
        ...

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        ...

    def where(self, condition: Tensor, other: Self) -> Self:
        """Return a state with the estimates of `other` where the condition, (B,) bool, is false."""
        ...

    def leading(self, size: int) -> Self:
        """Return the state of the leading components."""
        ...


Kept = TypeVar("Kept", bound=MemberState)


class FilterState(NamedTuple):
    """Complete state of a recursive estimator; new measurements need no earlier data.

    Attributes:
        belief: belief about the states of B members, float64; the last valid one for a failed member.
        time: () float64, time of the belief.
        steps: () int64, number of predictions so far.
        status: (B,) int64, see `Status`.
        failed_step: (B,) int64, index from 0 of the prediction during or after which the member failed; -1
            while OK.
        rejections: (B,) int64, current number of consecutive rows rejected by the gate.
        repairs: (B,) int64, number of repaired covariances.
        log_likelihood: (B,) float64, log-likelihood of the accepted measurements.
    """

    belief: Belief
    time: Tensor
    steps: Tensor
    status: Tensor
    failed_step: Tensor
    rejections: Tensor
    repairs: Tensor
    log_likelihood: Tensor

    @property
    def moments(self) -> Belief:
        """Mean (B, D) and factor of the covariance (B, D, D)."""
        return self.belief

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        return self.status == Status.OK

    def where(self, condition: Tensor, other: FilterState) -> FilterState:
        """Return a state with the belief of `other` for members where the condition, (B,) bool, is false."""
        return self._replace(belief=choose(condition, self.belief, other.belief))

    def leading(self, size: int) -> FilterState:
        """Return the state of the leading components."""
        return self._replace(belief=leading(self.belief, size))


def initial_state(belief: Belief, time: float = 0.0) -> FilterState:
    """Return the initial state of a batch."""
    device, members = belief.mean.device, (len(belief.mean),)
    zeros = torch.full(members, 0, dtype=torch.int64, device=device)
    return FilterState(
        belief=belief,
        time=torch.full((), time, dtype=torch.float64, device=device),
        steps=torch.full((), 0, dtype=torch.int64, device=device),
        status=zeros,
        failed_step=torch.full(members, -1, dtype=torch.int64, device=device),
        rejections=zeros,
        repairs=zeros,
        log_likelihood=torch.full(members, 0.0, dtype=torch.float64, device=device),
    )


def fail(state: Kept, bad: Tensor, status: Status) -> Kept:
    """Assign a status to active members among `bad`, (B,) bool."""
    bad = bad & state.alive
    if not bool(bad.any()):
        return state
    # Before the first prediction, failures belong to step 0.
    step = (state.steps - 1).clamp(min=0)
    return state._replace(
        status=torch.where(bad, int(status), state.status),
        failed_step=torch.where(bad, step, state.failed_step),
    )


def add_repairs(state: Kept, repairs: Tensor | None) -> Kept:
    """Add the repairs of active members, (B,) bool or int64, to their counts."""
    if repairs is None:
        return state
    return state._replace(repairs=state.repairs + repairs * state.alive)


def frozen(state: Kept, sound: Kept) -> Kept:
    """Return the state with failed members reset to their last valid estimates."""
    return state.where(state.alive, sound) if bool(state.status.any()) else state
