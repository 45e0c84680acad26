"""Book-keeping of the members of a batch: who failed, when, and what stands in for them.

A member that fails is frozen: it keeps its place in the batch with its initial belief, which is harmless,
so that the shapes, and with them every bit of the other members, stay as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status


class Members(NamedTuple):
    """State of the book-keeping, one row for each of B members.

    Attributes:
        status: (B,) int64.
        failed_step: (B,) int64, -1 while the status is OK.
        repairs: (B,) int64.
        rejections: (B,) int64, in a row up to now.
        log_likelihood: (B,) float64.
        all_ok: whether no member has failed; saves work on the common path.
    """

    status: Tensor
    failed_step: Tensor
    repairs: Tensor
    rejections: Tensor
    log_likelihood: Tensor
    all_ok: bool

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        return self.status == Status.OK


def start(belief: Belief) -> Members:
    """Return the books of a batch in which nothing has happened."""
    zeros = torch.zeros(len(belief.mean), dtype=torch.int64, device=belief.mean.device)
    return Members(zeros, zeros - 1, zeros, zeros, zeros.to(torch.float64), all_ok=True)


def fail(members: Members, bad: Tensor, status: Status, step: int) -> Members:
    """Give a status to the living members among `bad`, (B,) bool."""
    bad = bad & members.alive
    if not bool(bad.any()):
        return members
    return members._replace(
        status=torch.where(bad, int(status), members.status),
        failed_step=torch.where(bad, step, members.failed_step),
        all_ok=False,
    )


def add_repairs(members: Members, repairs: Tensor | None) -> Members:
    """Count the repairs of living members, (B,) bool or int64."""
    if repairs is None:
        return members
    return members._replace(repairs=members.repairs + repairs * members.alive)


def frozen(members: Members, belief: Belief, stand_in: Belief) -> Belief:
    """Return the belief with failed members replaced."""
    return belief if members.all_ok else choose(members.alive, belief, stand_in)


def choose(condition: Tensor, yes: Belief, no: Belief) -> Belief:
    """Return beliefs picked member by member; condition (B,) bool."""
    return Belief(
        torch.where(condition[:, None], yes.mean, no.mean),
        torch.where(condition[:, None, None], yes.chol, no.chol),
    )
