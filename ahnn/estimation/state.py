"""State of a recursive estimator between two calls, and the book-keeping of its members.

A member that fails is frozen: it keeps its place in the batch with the last belief that was sound, so that
the shapes, and with them every bit of the other members, stay as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose


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


def fail(state: FilterState, bad: Tensor, status: Status) -> FilterState:
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


def add_repairs(state: FilterState, repairs: Tensor | None) -> FilterState:
    """Count the repairs of living members, (B,) bool or int64."""
    if repairs is None:
        return state
    return state._replace(repairs=state.repairs + repairs * state.alive)


def frozen(state: FilterState, sound: Belief) -> FilterState:
    """Return the state in which members that failed have the belief that was sound."""
    if not bool(state.status.any()):
        return state
    return state._replace(belief=choose(state.alive, state.belief, sound))
