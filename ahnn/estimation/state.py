"""State of a recursive estimator between two calls, and the book-keeping of its members.

A member that fails is frozen: it keeps its place in the batch with the last belief that was sound, so that
the shapes, and with them every bit of the other members, stay as they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, Self, TypeVar

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose, leading


class EstimatorState(Protocol):
    """What an estimator carries for B members: a NamedTuple of tensors and of NamedTuples of tensors."""

    @property
    def time(self) -> Tensor:
        """() float64, at which it holds."""
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
    """A state with a status of each member, of Gaussian filters and of samples; see `FilterState`."""

    @property
    def belief(self) -> Belief:
        """The moments."""
        ...

    @property
    def steps(self) -> Tensor:
        """() int64, predictions made so far."""
        ...

    @property
    def failed_step(self) -> Tensor:
        """(B,) int64, the prediction at which the status was given."""
        ...

    @property
    def rejections(self) -> Tensor:
        """(B,) int64, rows that the gate refused in a row."""
        ...

    @property
    def repairs(self) -> Tensor:
        """(B,) int64, covariances that had to be mended."""
        ...

    @property
    def log_likelihood(self) -> Tensor:
        """(B,) float64, of the accepted measurements."""
        ...

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        ...

    def where(self, condition: Tensor, other: Self) -> Self:
        """Return the state in which members without the condition, (B,) bool, have another's estimates."""
        ...

    def leading(self, size: int) -> Self:
        """Return the state of the first components alone."""
        ...


Kept = TypeVar("Kept", bound=MemberState)


class FilterState(NamedTuple):
    """All that a recursive estimator carries; a new measurement needs nothing older than this.

    Attributes:
        belief: about the states of B members, float64; of a member that failed, the last sound one.
        time: () float64, at which the belief holds.
        steps: () int64, predictions made so far.
        status: (B,) int64, see `Status`.
        failed_step: (B,) int64, the prediction, counted from 0, in or after which the status was given; -1
            while it is OK.
        rejections: (B,) int64, rows that the gate refused in a row up to now.
        repairs: (B,) int64, covariances that had to be mended.
        log_likelihood: (B,) float64, of the accepted measurements.
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
        """Return the state in which members without the condition, (B,) bool, have another's belief."""
        return self._replace(belief=choose(condition, self.belief, other.belief))

    def leading(self, size: int) -> FilterState:
        """Return the state of the first components alone."""
        return self._replace(belief=leading(self.belief, size))


def initial_state(belief: Belief, time: float = 0.0) -> FilterState:
    """Return the state of a batch in which nothing has happened."""
    device = belief.mean.device
    zeros = torch.zeros(len(belief.mean), dtype=torch.int64, device=device)
    return FilterState(
        belief=belief,
        time=torch.tensor(time, dtype=torch.float64, device=device),
        steps=torch.tensor(0, dtype=torch.int64, device=device),
        status=zeros,
        failed_step=zeros - 1,
        rejections=zeros,
        repairs=zeros,
        log_likelihood=zeros.to(torch.float64),
    )


def fail(state: Kept, bad: Tensor, status: Status) -> Kept:
    """Give a status to the living members among `bad`, (B,) bool."""
    bad = bad & state.alive
    if not bool(bad.any()):
        return state
    # Before the first prediction there is only the start, which belongs to step 0.
    step = (state.steps - 1).clamp(min=0)
    return state._replace(
        status=torch.where(bad, int(status), state.status),
        failed_step=torch.where(bad, step, state.failed_step),
    )


def add_repairs(state: Kept, repairs: Tensor | None) -> Kept:
    """Count the repairs of living members, (B,) bool or int64."""
    if repairs is None:
        return state
    return state._replace(repairs=state.repairs + repairs * state.alive)


def frozen(state: Kept, sound: Kept) -> Kept:
    """Return the state in which members that failed have the estimates that were sound."""
    return state.where(state.alive, sound) if bool(state.status.any()) else state
