"""Time series for figures of a filter, saved with the predictions."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.consistency import deviations
from ahnn.evaluation import Case
from ahnn.evaluation.estimators.outcome import Outcome
from ahnn.evaluation.trajectory_figures import SMOOTHING
from ahnn.metrics import moving_average


class Sawtooth(NamedTuple):
    """Alternating estimates before and after each update, so that an update appears as a vertical line.

    Attributes:
        sample: (2 T + 1,) sample indices, each but the first twice.
        mean: (B, 2 T + 1, D) estimates.
        deviation: (B, 2 T + 1, D) standard deviations.
    """

    sample: Tensor
    mean: Tensor
    deviation: Tensor


def sawtooth(outcome: Outcome) -> Sawtooth:
    """Return the estimates of a filter before and after each update."""
    result = outcome.result
    samples = torch.arange(outcome.estimate.shape[1])
    mean = _in_turn(result.initial.mean, result.predicted_means, result.means)
    before, after = deviations(result.predicted_chols), deviations(result.chols)
    deviation = _in_turn(deviations(result.initial.chol), before, after)
    return Sawtooth(samples.repeat_interleave(2)[1:], mean, deviation)


def kept(teeth: Sawtooth, member: int) -> dict[str, Tensor]:
    """Return `mean` and `deviation` (2 T + 1, D) of one trajectory, and its index."""
    number = torch.tensor([member])
    return {"mean": teeth.mean[member], "deviation": teeth.deviation[member], "member": number}


def _in_turn(first: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Interleave as first, before_0, after_0, before_1, ..., (B, 2 T + 1, D)."""
    return torch.cat((first[:, None], torch.stack((before, after), dim=2).flatten(1, 2)), dim=1)


def blocks(x: Tensor, inertia: float | Tensor) -> tuple[Tensor, Tensor]:
    """Return the positions and the velocities (..., n) in states, or state errors, (..., 2 n)."""
    position, momentum = x.chunk(2, dim=-1)
    return position, momentum / inertia


def rms_over_members(error: Tensor, inertia: float | Tensor) -> Tensor:
    """Return the rms over active members of the error norms of position and velocity, (2, T).

    Failed members are excluded after their failure; their number is in the table.
    """
    norms = [block.square().sum(-1).nanmean(0).sqrt() for block in blocks(error, inertia)]
    return torch.stack(norms)


def smoothed_rms(error: Tensor, inertia: float | Tensor) -> Tensor:
    """Return the trailing means over 240 samples of `rms_over_members`, (2, T)."""
    return torch.stack([moving_average(row, SMOOTHING) for row in rms_over_members(error, inertia)])


def moving_averages(outcome: Outcome, case: Case) -> dict[str, dict[str, list[float]]]:
    """Return the moving averages of both errors at the measured samples, as plain values for metrics.json."""
    position, velocity = smoothed_rms(outcome.estimate - case.test.states, case.space.divisor)
    at = torch.nonzero((outcome.result.measured > 0).any(0)).flatten() + 1
    series = {"sample": at, "position": position[at], "velocity": velocity[at]}
    return {f"moving_average_{SMOOTHING}": {key: value.tolist() for key, value in series.items()}}
