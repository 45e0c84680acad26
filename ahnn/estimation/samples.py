"""Sample-based beliefs: moments, effective sample size, resampling, and filter state."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.estimation.belief import Belief, Status, choose, leading
from ahnn.estimation.linalg import EPS, tria
from ahnn.estimation.random_numbers import RandomNumbers


class SampleState(NamedTuple):
    """State of a sample filter for B members; undocumented fields as in `FilterState`.

    Attributes:
        belief: moments of the samples, computed once.
        time: () float64.
        steps: () int64.
        status: (B,) int64.
        failed_step: (B,) int64.
        rejections: (B,) int64.
        repairs: (B,) int64.
        log_likelihood: (B,) float64.
        points: (B, N, D) float64 samples.
        log_weights: (B, N) float64 logarithms of normalised weights; -inf for zero weight.
        seed: () int64, random seed.
        updates: () int64, updates since the last prediction; with seed and steps it determines the next draw.
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
        """Random numbers for the current counters."""
        return RandomNumbers(int(self.seed), int(self.steps), int(self.updates))

    def where(self, condition: Tensor, other: SampleState) -> SampleState:
        """Return a state with the samples of `other` for members where the condition, (B,) bool, is false."""
        return self._replace(
            belief=choose(condition, self.belief, other.belief),
            points=torch.where(condition[:, None, None], self.points, other.points),
            log_weights=torch.where(condition[:, None], self.log_weights, other.log_weights),
        )

    def leading(self, size: int) -> SampleState:
        """Return the state of the leading components."""
        return self._replace(belief=leading(self.belief, size), points=self.points[..., :size])


def sample_moments(points: Tensor, log_weights: Tensor | None = None) -> Belief:
    """Return the moments of samples (B, N, D).

    Without weights these are the moments of an ensemble, with N - 1 in the denominator of the covariance;
    with weights, the moments of the discrete distribution, sum_i w_i (x_i - mean)(x_i - mean)ᵀ.

    Args:
        points: (B, N, D) samples.
        log_weights: (B, N) normalised log weights; None for an ensemble.
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
    """Normalise log weights (B, N) to a sum of weights of 1; NaN where all weights are zero."""
    return log_weights - log_weights.logsumexp(-1, keepdim=True)


def effective_size(log_weights: Tensor) -> Tensor:
    """Return the effective sample size 1 / sum w², (B,), of normalised weights (Kong, Liu & Wong 1994)."""
    return (-(2.0 * log_weights).logsumexp(-1)).exp()


def systematic_resampling(log_weights: Tensor, offset: Tensor) -> Tensor:
    """Return the sorted indices (B, N) of resampled points, from one uniform number per member.

    A sample of weight w is drawn floor(N w) or ceil(N w) times, N w on average (Kitagawa 1996; Douc, Cappé &
    Moulines 2005).

    Args:
        log_weights: (B, N) normalised log weights.
        offset: (B,) uniform numbers in [0, 1).
    """
    count = log_weights.shape[-1]
    cumulative = log_weights.exp().cumsum(-1)
    cumulative = cumulative / cumulative[:, -1:]
    places = (torch.arange(count, dtype=offset.dtype, device=offset.device) + offset.unsqueeze(-1)) / count
    # Rounding may move a position to 1, beyond the last sample with nonzero weight.
    chosen = torch.searchsorted(cumulative.contiguous(), places.clamp(max=1.0 - 0.5 * EPS), right=True)
    return chosen.clamp(max=count - 1)  # for NaN weights
