"""Precision of a Gaussian prior on the parameters, by maximum evidence.

With residuals r in standard deviations and their Jacobian J, the posterior of the parameters is approximately

    N(theta, H^-1),   H = J^T J + diag(alpha),

and the evidence p(data | alpha), the integral over theta, is largest where alpha_g |theta_g|^2 = gamma_g, the
number of parameters of group g that the data determine (MacKay 1992, Neural Computation 4, 448-472). A group
is a parameter tensor: weights and biases of each layer have individual scales (Neal 1996, chapter 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

BEGIN = 1.0
"""Initial precision, kept by groups that the data do not determine."""
NOTHING = 1e-6
"""Fraction of determined parameters below which a group counts as undetermined."""
ROUNDS, SETTLED = 200, 1e-4
"""Maximum number of fixed-point iterations, and relative change for convergence."""


class Prior(NamedTuple):
    """Prior theta_g ~ N(0, 1 / alpha_g) on the parameters of each of G groups.

    Attributes:
        strengths: precisions alpha, shape (G,).
        sizes: number of parameters of each group, P in total.
    """

    strengths: Tensor
    sizes: Sequence[int]

    @property
    def precision(self) -> Tensor:
        """Diagonal of the prior's inverse covariance, shape (P,)."""
        return self.strengths.repeat_interleave(torch.tensor(list(self.sizes)))

    def penalty(self, theta: Tensor) -> Tensor:
        """Return the prior's contribution to the sum of squares at theta, shape (P,)."""
        return self.precision @ theta.square()


def posterior_factor(matrix: Tensor, prior: Prior) -> Tensor:
    """Return L, shape (P, P), with L L^T the inverse of J^T J + diag(alpha).

    Directions of J^T J below rounding are treated as determined, so that the factor exists.

    Args:
        matrix: J^T J, shape (P, P), float64: products in float32 lose all digits of poorly determined
            directions.
        prior: prior on the parameters.
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
    """Return the prior of maximum evidence at fixed theta.

    Args:
        matrix: J^T J, shape (P, P), float64.
        theta: the parameters, shape (P,).
        sizes: number of parameters of each group.
    """
    squares = torch.stack([part.square().sum() for part in theta.split(list(sizes))])
    prior = Prior(torch.full_like(squares, BEGIN), sizes)
    known = squares > 0
    for _ in range(ROUNDS):
        gamma = determined(posterior_factor(matrix, prior), prior)
        informed = known & (gamma > NOTHING * torch.tensor(list(sizes)))
        wanted = torch.where(informed, gamma / squares.clamp(min=torch.finfo(squares.dtype).tiny), BEGIN)
        # The iteration alpha -> gamma(alpha) / |theta|^2 has a slope between -1 and 0, so averaging its
        # result with alpha prevents oscillation.
        settled = bool(((wanted / prior.strengths).log().abs() <= SETTLED).all())
        prior = prior._replace(strengths=(prior.strengths * wanted).sqrt())
        if settled:
            break
    return prior


def log_evidence(matrix: Tensor, loss: Tensor, count: int, theta: Tensor, prior: Prior) -> float:
    """Return log p(data | alpha) of residuals with unit noise, by Laplace's method.

    Args:
        matrix: J^T J, shape (P, P), at theta.
        loss: r^T r at theta.
        count: number of residuals.
        theta: maximum of the posterior, shape (P,).
        prior: prior on the parameters.
    """
    factor = posterior_factor(matrix, prior)
    volume = factor.diagonal().log().sum() + 0.5 * prior.precision.log().sum()
    misfit = -0.5 * (loss + prior.penalty(theta)) - 0.5 * count * math.log(2 * math.pi)
    return float(misfit + volume)
