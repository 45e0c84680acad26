"""Mixtures of normal forecasts: mean, covariance, and the continuous ranked probability score."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def mixture_moments(states: Tensor, covariances: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return mean (..., D) and covariance (..., D, D) of an equally weighted mixture.

    The covariance follows the law of total covariance; that of the means has the divisor S - 1, since members
    are a sample.

    Args:
        states: means of the S >= 2 members, (S, ..., D).
        covariances: covariances of the members, (S, ..., D, D); None for exact members.
    """
    mean = states.mean(0)
    off = states - mean
    covariance = torch.einsum("s...i,s...j->...ij", off, off) / (len(states) - 1)
    return mean, covariance if covariances is None else covariance + covariances.mean(0)


def mixture_crps(truth: Tensor, means: Tensor, deviations: Tensor | None = None) -> Tensor:
    """Return the continuous ranked probability score of an equally weighted mixture of normals, (...).

    It is the integral of (F(z) - [z >= truth])^2 over z in the unit of the truth, and |error| for a forecast
    of zero width. With A(m, v) = E|N(m, v)|, it is the mean of A(truth - m_i, v_i) minus half the mean of
    A(m_i - m_j, v_i + v_j) (Grimit, Gneiting, Berrocal & Johnson 2006, Q. J. R. Meteorol. Soc. 132,
    2925-2942).

    Args:
        truth: true values, (...).
        means: means of the S members, (S, ...).
        deviations: standard deviations of the members, (S, ...); None for zero width.
    """
    variances = torch.zeros_like(means) if deviations is None else deviations.square()
    near = _absolute(truth - means, variances).mean(0)
    apart = torch.zeros_like(near)
    for mean, variance in zip(means, variances, strict=True):  # all pairs together would fill the memory
        apart = apart + _absolute(means - mean, variances + variance).mean(0)
    return near - apart / (2 * len(means))


def _absolute(mean: Tensor, variance: Tensor) -> Tensor:
    """Return E|N(mean, variance)|, shape (...)."""
    deviation = variance.sqrt()
    ratio = mean / deviation.where(deviation > 0, 1.0)
    density = torch.exp(-0.5 * ratio.square()) / math.sqrt(2 * math.pi)
    wide = 2 * deviation * density + mean * torch.erf(ratio / math.sqrt(2))
    return torch.where(deviation > 0, wide, mean.abs())
