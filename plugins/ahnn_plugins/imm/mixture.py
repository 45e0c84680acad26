"""Mixture of Gaussian beliefs, one per mode: moments, filter state, and Markov chain."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose, leading
from ahnn.estimation.linalg import tria


class MixtureState(NamedTuple):
    """State of interacting models for B members; fields without a description are as in `FilterState`.

    Attributes:
        belief: moments of the mixture, computed once.
        time: () float64.
        steps: () int64.
        status: (B,) int64.
        failed_step: (B,) int64.
        rejections: (B,) int64.
        repairs: (B,) int64.
        log_likelihood: (B,) float64.
        mode_means: (B, K, D) float64.
        mode_chols: (B, K, D, D) float64 lower factors.
        log_modes: (B, K) float64 logarithms of the normalised mode probabilities.
    """

    belief: Belief
    time: Tensor
    steps: Tensor
    status: Tensor
    failed_step: Tensor
    rejections: Tensor
    repairs: Tensor
    log_likelihood: Tensor
    mode_means: Tensor
    mode_chols: Tensor
    log_modes: Tensor

    @property
    def moments(self) -> Belief:
        """Mean (B, D) and factor of the covariance (B, D, D)."""
        return self.belief

    @property
    def probabilities(self) -> Tensor:
        """Probabilities of the modes, (B, K)."""
        return self.log_modes.exp()

    @property
    def beliefs(self) -> list[Belief]:
        """The K beliefs."""
        parts = zip(self.mode_means.unbind(1), self.mode_chols.unbind(1), strict=True)
        return [Belief(*part) for part in parts]

    @property
    def alive(self) -> Tensor:
        """(B,) bool, true where the status is OK."""
        return self.status == Status.OK

    def mixed(self, beliefs: list[Belief], log_modes: Tensor) -> MixtureState:
        """Return the state with K new beliefs and log probabilities (B, K)."""
        means, chols = (torch.stack(parts, 1) for parts in zip(*beliefs, strict=True))
        moments = mixture_moments(means, chols, log_modes.exp())
        return self._replace(belief=moments, mode_means=means, mode_chols=chols, log_modes=log_modes)

    def where(self, condition: Tensor, other: MixtureState) -> MixtureState:
        """Return the state with beliefs of `other` for members whose condition, (B,) bool, is false."""
        column = condition[:, None, None]
        return self._replace(
            belief=choose(condition, self.belief, other.belief),
            mode_means=torch.where(column, self.mode_means, other.mode_means),
            mode_chols=torch.where(column.unsqueeze(-1), self.mode_chols, other.mode_chols),
            log_modes=torch.where(condition[:, None], self.log_modes, other.log_modes),
        )

    def leading(self, size: int) -> MixtureState:
        """Return the state of the first `size` components."""
        means, chols = self.mode_means[..., :size], self.mode_chols[..., :size, :size]
        return self._replace(belief=leading(self.belief, size), mode_means=means, mode_chols=chols)


def mixture_moments(means: Tensor, chols: Tensor, weights: Tensor) -> Belief:
    """Return the moments of mixtures: sum_k w_k m_k, and sum_k w_k (P_k + (m_k - m)(m_k - m)ᵀ) as a factor.

    Args:
        means: (B, K, D) means m_k.
        chols: (B, K, D, D) lower factors of P_k.
        weights: (B, K) normalised weights w_k.
    """
    weights = weights.unsqueeze(-1)
    mean = (weights * means).sum(1)
    apart = weights.sqrt() * (means - mean.unsqueeze(1))
    spread = (weights.unsqueeze(-1).sqrt() * chols.mT).flatten(1, 2)
    return Belief(mean, tria(torch.cat((spread, apart), dim=1)))


class Mixing(NamedTuple):
    """Mode transition probabilities of a step.

    Attributes:
        log_modes: (B, K) log probabilities of the modes after the step.
        origins: (B, K, K) probabilities, at [:, j, i], of mode i before the step given mode j after it.
    """

    log_modes: Tensor
    origins: Tensor


def mixing(log_modes: Tensor, dwell: Tensor, dt: float) -> Mixing:
    """Return the mode transitions of a Markov chain with exponentially distributed durations.

    Transitions to all other modes are equally probable. The chain is continuous in time: two steps of dt / 2
    equal one of dt, so that results do not depend on the intervals between measurements.

    Args:
        log_modes: (B, K) log probabilities before the step.
        dwell: (K,) mean durations of modes.
        dt: step length.
    """
    count = len(dwell)
    rates = (1.0 / dwell).unsqueeze(-1) * (torch.ones(count, count).to(dwell) / (count - 1))
    rates = rates - torch.diag(rates.diagonal()) - torch.diag(1.0 / dwell)
    chain = torch.linalg.matrix_exp(rates * dt).clamp(min=0.0)
    joint = log_modes.unsqueeze(-1) + (chain / chain.sum(-1, keepdim=True)).log()  # [before, after]
    after = joint.logsumexp(1)
    after = after - after.logsumexp(-1, keepdim=True)
    return Mixing(after, joint.softmax(1).mT)


def stacked(belief: Belief, count: int) -> tuple[Tensor, Tensor]:
    """Replicate a belief for K modes, (B, K, D) and (B, K, D, D)."""
    mean, chol = belief
    return mean.unsqueeze(1).repeat(1, count, 1), chol.unsqueeze(1).repeat(1, count, 1, 1)
