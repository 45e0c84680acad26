"""How strong a Gaussian prior on the parameters is, by the evidence of the data.

With residuals r in standard deviations and their Jacobian J, the posterior of the parameters is about

    N(theta, H^-1),   H = J^T J + diag(alpha),

and the evidence p(data | alpha), the integral over theta, is largest where alpha_g |theta_g|^2 = gamma_g, the
number of parameters of group g that the data determine (MacKay 1992, Neural Computation 4, 448-472). A group
is a tensor of parameters: weights and biases of each layer have a scale of their own (Neal 1996, chapter 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

BEGIN = 1.0
"""Strength that the iteration begins with, and that a group keeps of which the data say nothing."""
NOTHING = 1e-6
"""Share of its parameters that the data determine in such a group."""
ROUNDS, SETTLED = 200, 1e-4
"""Fixed-point iterations at most, and the relative change of a strength that is none."""


class Prior(NamedTuple):
    """Parameters theta_g ~ N(0, 1 / alpha_g) in each of G groups.

    Attributes:
        strengths: alpha, shape (G,).
        sizes: parameters of each group, P together.
    """

    strengths: Tensor
    sizes: Sequence[int]

    @property
    def precision(self) -> Tensor:
        """Diagonal of the prior's inverse covariance, shape (P,)."""
        return self.strengths.repeat_interleave(torch.tensor(list(self.sizes)))

    def penalty(self, theta: Tensor) -> Tensor:
        """Return what the prior adds to the sum of squared residuals at theta, shape (P,)."""
        return self.precision @ theta.square()


def posterior_factor(matrix: Tensor, prior: Prior) -> Tensor:
    """Return L, shape (P, P), with L L^T the inverse of J^T J + diag(alpha).

    What rounding leaves unknown of J^T J counts as known, so that its factor exists.

    Args:
        matrix: J^T J, shape (P, P), float64: products in float32 have no digits left for what is badly known.
        prior: of the parameters.
    """
    rounding = len(matrix) * torch.finfo(matrix.dtype).eps * matrix.diagonal()
    lower = torch.linalg.cholesky(matrix + torch.diag(prior.precision + rounding))
    one = torch.eye(len(matrix)).to(matrix)
    return torch.linalg.solve_triangular(lower, one, upper=False).mT


def determined(factor: Tensor, prior: Prior) -> Tensor:
    """Return gamma_g = n_g - alpha_g tr_g(H^-1), shape (G,), from L with L L^T = H^-1."""
    left = prior.precision * factor.square().sum(1)
    return torch.stack([(1 - part).sum().clamp(min=0) for part in left.split(list(prior.sizes))])


def by_evidence(matrix: Tensor, theta: Tensor, sizes: Sequence[int]) -> Prior:
    """Return the prior that makes the evidence largest, theta held where it is.

    Args:
        matrix: J^T J, shape (P, P), float64.
        theta: the parameters, shape (P,).
        sizes: parameters of each group.
    """
    squares = torch.stack([part.square().sum() for part in theta.split(list(sizes))])
    prior = Prior(torch.full_like(squares, BEGIN), sizes)
    known = squares > 0
    for _ in range(ROUNDS):
        gamma = determined(posterior_factor(matrix, prior), prior)
        told = known & (gamma > NOTHING * torch.tensor(list(sizes)))
        wanted = torch.where(told, gamma / squares.clamp(min=torch.finfo(squares.dtype).tiny), BEGIN)
        # alpha -> gamma(alpha) / |theta|^2 falls with alpha with a slope of at most 1: its mean with alpha
        # does not swing.
        settled = bool(((wanted / prior.strengths).log().abs() <= SETTLED).all())
        prior = prior._replace(strengths=(prior.strengths * wanted).sqrt())
        if settled:
            break
    return prior


def log_evidence(matrix: Tensor, loss: Tensor, count: int, theta: Tensor, prior: Prior) -> float:
    """Return log p(data | alpha) of residuals in standard deviations, of unit noise, by Laplace's method.

    Args:
        matrix: J^T J, shape (P, P), at theta.
        loss: r^T r there.
        count: of the residuals.
        theta: where the posterior is largest, shape (P,).
        prior: of the parameters.
    """
    factor = posterior_factor(matrix, prior)
    volume = factor.diagonal().log().sum() + 0.5 * prior.precision.log().sum()
    misfit = -0.5 * (loss + prior.penalty(theta)) - 0.5 * count * math.log(2 * math.pi)
    return float(misfit + volume)
