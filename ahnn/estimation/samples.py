"""Samples as a belief: moments, effective size, resampling, and the state that carries them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.estimation.belief import Belief, Status, choose, leading
from ahnn.estimation.linalg import EPS, tria
from ahnn.estimation.random_numbers import RandomNumbers


class SampleState(NamedTuple):
    """All that a filter of samples carries for B members; what is not said here as of `FilterState`.

    Attributes:
        belief: moments of what is believed, computed once.
        time: () float64.
        steps: () int64.
        status: (B,) int64.
        failed_step: (B,) int64.
        rejections: (B,) int64.
        repairs: (B,) int64.
        log_likelihood: (B,) float64.
        points: (B, N, D) float64 samples.
        log_weights: (B, N) float64 logarithms of their weights, which sum to 1; -inf of one that counts
            nothing.
        seed: () int64, of the random numbers.
        updates: () int64, updates since the last prediction; with seed and steps it says what is drawn next.
    """

    belief: Belief
    time: Tensor
    steps: Tensor
    status: Tensor
    failed_step: Tensor
    rejections: Tensor
    repairs: Tensor
    log_likelihood: Tensor
    points: Tensor
    log_weights: Tensor
    seed: Tensor
    updates: Tensor

    @property
    def moments(self) -> Belief:
        """Mean (B, D) and factor of the covariance (B, D, D)."""
        return self.belief

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        return self.status == Status.OK

    @property
    def random(self) -> RandomNumbers:
        """What is drawn at this place."""
        return RandomNumbers(int(self.seed), int(self.steps), int(self.updates))

    def where(self, condition: Tensor, other: SampleState) -> SampleState:
        """Return the state in which members without the condition, (B,) bool, have another's samples."""
        return self._replace(
            belief=choose(condition, self.belief, other.belief),
            points=torch.where(condition[:, None, None], self.points, other.points),
            log_weights=torch.where(condition[:, None], self.log_weights, other.log_weights),
        )

    def leading(self, size: int) -> SampleState:
        """Return the state of the first components alone."""
        return self._replace(belief=leading(self.belief, size), points=self.points[..., :size])


def sample_moments(points: Tensor, log_weights: Tensor | None = None) -> Belief:
    """Return the moments of samples (B, N, D).

    Without weights those of an ensemble, whose covariance has N - 1 in its denominator; with weights those of
    the law that the samples are, sum_i w_i (x_i - mean)(x_i - mean)ᵀ.

    Args:
        points: (B, N, D).
        log_weights: (B, N), normalised; None for an ensemble.
    """
    count, size = points.shape[-2:]
    if log_weights is None:
        mean = points.mean(1)
        rows = (points - mean.unsqueeze(1)) / max(count - 1, 1) ** 0.5
    else:
        weights = log_weights.exp().unsqueeze(-1)
        mean = (weights * points).sum(1)
        rows = weights.sqrt() * (points - mean.unsqueeze(1))
    return Belief(mean, tria(pad(rows, (0, 0, 0, max(size - count, 0)))))


def normalised(log_weights: Tensor) -> Tensor:
    """Return logarithms (B, N) of weights that sum to 1; NaN where all weights are zero."""
    return log_weights - log_weights.logsumexp(-1, keepdim=True)


def effective_size(log_weights: Tensor) -> Tensor:
    """Return the effective sample size 1 / sum w², (B,), of normalised weights (Kong, Liu & Wong 1994)."""
    return (-(2.0 * log_weights).logsumexp(-1)).exp()


def systematic_resampling(log_weights: Tensor, offset: Tensor) -> Tensor:
    """Return the numbers (B, N) of the samples that are drawn, in order, by one uniform number a member.

    A sample of weight w is drawn floor(N w) or ceil(N w) times, N w on average (Kitagawa 1996; Douc, Cappé &
    Moulines 2005).

    Args:
        log_weights: (B, N), normalised.
        offset: (B,) numbers of [0, 1).
    """
    count = log_weights.shape[-1]
    cumulative = log_weights.exp().cumsum(-1)
    cumulative = cumulative / cumulative[:, -1:]
    places = (torch.arange(count, dtype=offset.dtype, device=offset.device) + offset.unsqueeze(-1)) / count
    # Rounding may take a place to 1, beyond the last sample that has a weight.
    chosen = torch.searchsorted(cumulative.contiguous(), places.clamp(max=1.0 - 0.5 * EPS), right=True)
    return chosen.clamp(max=count - 1)  # where weights are no numbers
