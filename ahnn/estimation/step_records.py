"""Records of filter steps, and their collection into a result."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.state import MemberState


class StepRecord(NamedTuple):
    """Record of n successive steps, of which single ones have a backward law.

    Attributes:
        predicted: beliefs before the updates, (n, B, ...).
        posterior: beliefs after them.
        innovation: (n, B, M) innovations, NaN where a step has no row; None if none has one.
        nis: (n, B) normalised innovation squared, likewise.
        rejected: (n, B) rejections by the gate, likewise.
        backward: law of the step back, (B, D, D), if requested.
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
        told = updated.innovation.unsqueeze(0), updated.nis.unsqueeze(0), rejected.unsqueeze(0)
        return cls(before, after, *told, backward)

    @property
    def length(self) -> int:
        """Number of steps n."""
        return len(self.predicted.mean)


def collected(
    steps: list[StepRecord], before: MemberState, after: MemberState, measurements: Tensor
) -> FilterResult:
    """Collect step records between two states into a result, NaN after the failure of a member."""
    present = ~torch.isnan(measurements)
    failed_step = torch.where(after.alive, -1, (after.failed_step - before.steps).clamp(min=0))
    valid = _valid(after, failed_step, measurements.shape[1])
    blank = measurements.new_full(measurements.shape, torch.nan, dtype=torch.float64).transpose(0, 1)
    nothing = torch.zeros_like(blank[..., 0], dtype=torch.bool)
    innovations = _joined([(s.innovation, s.length) for s in steps], blank)
    nis = _joined([(s.nis, s.length) for s in steps], blank[..., 0])
    return FilterResult(
        initial=before.belief,
        means=_masked(_in_turn([s.posterior.mean for s in steps]), valid),
        chols=_masked(_in_turn([s.posterior.chol for s in steps]), valid),
        predicted_means=_masked(_in_turn([s.predicted.mean for s in steps]), valid),
        predicted_chols=_masked(_in_turn([s.predicted.chol for s in steps]), valid),
        innovations=_masked(torch.where(present, innovations, torch.nan), valid),
        nis=_masked(torch.where(present.any(-1), nis, torch.nan), valid),
        measured=present.sum(-1),
        rejected=_joined([(s.rejected, s.length) for s in steps], nothing),
        log_likelihood=after.log_likelihood,
        status=after.status,
        failed_step=failed_step,
        repairs=after.repairs,
        backward=_stacked([s.backward for s in steps if s.backward is not None]),
        state=after,
    )


def _in_turn(parts: list[Tensor]) -> Tensor:
    """Return records (n, B, ...) in the order of members, (B, T, ...)."""
    return torch.cat(parts).transpose(0, 1).contiguous()


def _joined(parts: list[tuple[Tensor | None, int]], blank: Tensor) -> Tensor:
    """Return records of n steps as (B, T, ...), those of `blank`, (T, B, ...), for none."""
    return _in_turn([blank[:count] if part is None else part.to(blank.dtype) for part, count in parts])


def _valid(state: MemberState, failed_step: Tensor, steps: int) -> Tensor | None:
    """Return the mask of valid steps, (B, T) bool; None if all are valid."""
    if not bool(state.status.any()):
        return None
    step = torch.arange(steps, device=state.status.device)
    return state.alive[:, None] | (step < failed_step[:, None])


def _masked(values: Tensor, valid: Tensor | None) -> Tensor:
    """Return values (B, T, ...) with NaN at invalid steps."""
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
