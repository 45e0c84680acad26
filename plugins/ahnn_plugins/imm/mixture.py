"""A mixture of Gaussian beliefs, one for each mode: its moments, its state, and the chain that mixes it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose, leading
from ahnn.estimation.linalg import tria


class MixtureState(NamedTuple):
    """All that interacting models carry for B members; what is not said here as of `FilterState`.

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
        log_modes: (B, K) float64 logarithms of the probabilities of the modes, which sum to 1.
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
        """Return the state with other beliefs (K of them) and modes (B, K)."""
        means, chols = (torch.stack(parts, 1) for parts in zip(*beliefs, strict=True))
        moments = mixture_moments(means, chols, log_modes.exp())
        return self._replace(belief=moments, mode_means=means, mode_chols=chols, log_modes=log_modes)

    def where(self, condition: Tensor, other: MixtureState) -> MixtureState:
        """Return the state in which members without the condition, (B,) bool, have another's beliefs."""
        column = condition[:, None, None]
        return self._replace(
            belief=choose(condition, self.belief, other.belief),
            mode_means=torch.where(column, self.mode_means, other.mode_means),
            mode_chols=torch.where(column.unsqueeze(-1), self.mode_chols, other.mode_chols),
            log_modes=torch.where(condition[:, None], self.log_modes, other.log_modes),
        )

    def leading(self, size: int) -> MixtureState:
        """Return the state of the first components alone."""
        means, chols = self.mode_means[..., :size], self.mode_chols[..., :size, :size]
        return self._replace(belief=leading(self.belief, size), mode_means=means, mode_chols=chols)


def mixture_moments(means: Tensor, chols: Tensor, weights: Tensor) -> Belief:
    """Return the moments of mixtures: sum_k w_k m_k, and sum_k w_k (P_k + (m_k - m)(m_k - m)ᵀ) as a factor.

    Args:
        means: (B, K, D).
        chols: (B, K, D, D) lower factors of P_k.
        weights: (B, K) that sum to 1.
    """
    weights = weights.unsqueeze(-1)
    mean = (weights * means).sum(1)
    apart = weights.sqrt() * (means - mean.unsqueeze(1))
    spread = (weights.unsqueeze(-1).sqrt() * chols.mT).flatten(1, 2)
    return Belief(mean, tria(torch.cat((spread, apart), dim=1)))


class Mixing(NamedTuple):
    """Where modes come from in a step.

    Attributes:
        log_modes: (B, K) probabilities of the modes after it.
        origins: (B, K, K) probabilities of mode i before it, given mode j after it, at [:, j, i].
    """

    log_modes: Tensor
    origins: Tensor


def mixing(log_modes: Tensor, dwell: Tensor, dt: float) -> Mixing:
    """Return what a step of a Markov chain does, whose modes last an exponentially distributed time.

    From a mode all others are equally probable. The chain is one in continuous time: two steps of dt / 2 are
    one of dt, so that intervals between measurements do not matter.

    Args:
        log_modes: (B, K) before it.
        dwell: (K,) mean times that modes last.
        dt: length of the step.
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
    """Return one belief as that of each of K modes, (B, K, D) and (B, K, D, D)."""
    mean, chol = belief
    return mean.unsqueeze(1).repeat(1, count, 1), chol.unsqueeze(1).repeat(1, count, 1, 1)
