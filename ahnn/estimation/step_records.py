"""Records of filter steps, and their collection into a result."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.state import MemberState


class StepRecord(NamedTuple):
    """Record of n successive steps; it has a backward law only for n = 1.

    Attributes:
        predicted: beliefs before the updates, (n, B, ...).
        posterior: beliefs after them.
        innovation: (n, B, M) innovations, NaN where a step has no row; None if no step has a row.
        nis: (n, B) normalised innovation squared, likewise.
        rejected: (n, B) rejections by the gate, likewise.
        backward: backward law of the step, (B, D, D), if requested.
    """

    predicted: Belief
    posterior: Belief
    innovation: Tensor | None
    nis: Tensor | None
    rejected: Tensor | None
    backward: Backward | None

    @classmethod
    def of_one(
        cls,
        predicted: Belief,
        posterior: Belief,
        updated: Updated | None,
        rejected: Tensor | None,
        backward: Backward | None,
    ) -> StepRecord:
        """Build the record of one step from its beliefs (B, ...) and its update, if any."""
        before, after = (Belief(*(part.unsqueeze(0) for part in belief)) for belief in (predicted, posterior))
        if updated is None or rejected is None:
            return cls(before, after, None, None, None, backward)
        outcome = updated.innovation.unsqueeze(0), updated.nis.unsqueeze(0), rejected.unsqueeze(0)
        return cls(before, after, *outcome, backward)

    @property
    def length(self) -> int:
        """Number of steps n."""
        return len(self.predicted.mean)


def collected(
    steps: list[StepRecord], before: MemberState, after: MemberState, present: Tensor, *, whole: bool
) -> FilterResult:
    """Collect step records between two states into a result; values are NaN from a member's failed step on.

    Args:
        steps: records of the T steps.
        before: state before the first step.
        after: state after the last step.
        present: (B, T, M) bool, the measured components.
        whole: whether all components are measured.
    """
    failed_step, valid = after.failed_step, None
    if bool(after.status.any()):
        failed_step = torch.where(after.alive, -1, (failed_step - before.steps).clamp(min=0))
        step = torch.arange(present.shape[1], device=present.device)
        valid = after.alive[:, None] | (step < failed_step[:, None])
    batch, _, width = present.shape
    blank = torch.full((), torch.nan, dtype=torch.float64, device=present.device)
    innovations = _joined([(s.innovation, s.length) for s in steps], blank, batch, width)
    nis = _joined([(s.nis, s.length) for s in steps], blank, batch)
    if not whole:
        innovations = torch.where(present, innovations, torch.nan)
        nis = torch.where(present.any(-1), nis, torch.nan)
    return FilterResult(
        initial=before.belief,
        means=_masked(_in_turn([s.posterior.mean for s in steps]), valid),
        chols=_masked(_in_turn([s.posterior.chol for s in steps]), valid),
        predicted_means=_masked(_in_turn([s.predicted.mean for s in steps]), valid),
        predicted_chols=_masked(_in_turn([s.predicted.chol for s in steps]), valid),
        innovations=_masked(innovations, valid),
        nis=_masked(nis, valid),
        measured=present.sum(-1),
        rejected=_joined([(s.rejected, s.length) for s in steps], present.new_zeros(()), batch),
        log_likelihood=after.log_likelihood,
        status=after.status,
        failed_step=failed_step,
        repairs=after.repairs,
        backward=_stacked([s.backward for s in steps if s.backward is not None]),
        state=after,
    )


def _in_turn(parts: list[Tensor]) -> Tensor:
    """Join records (n, B, ...) of successive steps to (B, T, ...)."""
    return torch.cat(parts).transpose(0, 1).contiguous()


def _joined(parts: list[tuple[Tensor | None, int]], blank: Tensor, *shape: int) -> Tensor:
    """Join records (n, B, ...) with their lengths n to (B, T, ...); `blank` where a record is None."""
    return _in_turn([blank.expand(n, *shape) if part is None else part for part, n in parts])


def _masked(values: Tensor, valid: Tensor | None) -> Tensor:
    """Return values (B, T, ...) with NaN where the mask (B, T) is false; unchanged if the mask is None."""
    if valid is None:
        return values
    return torch.where(valid.reshape(valid.shape + (1,) * (values.ndim - 2)), values, torch.nan)


def _stacked(kernels: list[Backward]) -> Backward | None:
    if not kernels:
        return None
    return Backward(
        torch.stack([kernel.gain for kernel in kernels], dim=1),
        torch.stack([kernel.chol for kernel in kernels], dim=1),
    )
