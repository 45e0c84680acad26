"""Records of filter steps, and their collection into a result."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Backward, FilterResult, Updated
from ahnn.estimation.state import MemberState


class StepRecord(NamedTuple):
    """Record of one step: beliefs before and after the update, and the update, if any."""

    predicted: Belief
    posterior: Belief
    updated: Updated | None
    rejected: Tensor | None
    backward: Backward | None


def collected(
    steps: list[StepRecord], before: MemberState, after: MemberState, measurements: Tensor
) -> FilterResult:
    """Collect step records between two states into a result, NaN from the failed step of a member on."""
    present = ~torch.isnan(measurements)
    failed_step = torch.where(after.alive, -1, (after.failed_step - before.steps).clamp(min=0))
    valid = _valid(after, failed_step, len(steps))
    innovations = measurements.new_full(measurements.shape, torch.nan, dtype=torch.float64)
    nis = innovations.new_full(measurements.shape[:2], torch.nan)
    rejected = torch.zeros_like(nis, dtype=torch.bool)
    if told := [k for k, step in enumerate(steps) if step.updated is not None]:
        updates = [cast(Updated, steps[k].updated) for k in told]
        innovations[:, told] = torch.stack([one.innovation for one in updates], dim=1).to(innovations)
        nis[:, told] = torch.stack([one.nis for one in updates], dim=1).to(nis)
        rejected[:, told] = torch.stack([cast(Tensor, steps[k].rejected) for k in told], dim=1)
    return FilterResult(
        initial=before.belief,
        means=_masked(torch.stack([s.posterior.mean for s in steps], dim=1), valid),
        chols=_masked(torch.stack([s.posterior.chol for s in steps], dim=1), valid),
        predicted_means=_masked(torch.stack([s.predicted.mean for s in steps], dim=1), valid),
        predicted_chols=_masked(torch.stack([s.predicted.chol for s in steps], dim=1), valid),
        innovations=_masked(torch.where(present, innovations, torch.nan), valid),
        nis=_masked(torch.where(present.any(-1), nis, torch.nan), valid),
        measured=present.sum(-1),
        rejected=rejected,
        log_likelihood=after.log_likelihood,
        status=after.status,
        failed_step=failed_step,
        repairs=after.repairs,
        backward=_stacked([s.backward for s in steps if s.backward is not None]),
        state=after,
    )


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
