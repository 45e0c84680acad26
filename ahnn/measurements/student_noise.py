"""Student's noise: normal scores of residuals, alone and with a normal error of the prediction.

The normal score of a residual e is z = Phi^-1(F(e)), where F is its assumed distribution: if F is right, z is
standard normal whatever the tails of F, so that tests of normal residuals apply to z.

Student's noise with nu degrees of freedom is normal noise of variance 1 / g with g ~ Gamma(nu / 2, nu / 2)
(Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881-896). Together with a normal error of variance v it
is a mixture over g of normal errors of variance 1 / g + v.
"""

from __future__ import annotations

import torch
from torch import Tensor

NODES, REACH = 161, 8.0
"""Quadrature over g: number of evenly spaced standard normal quantiles of g, and the largest one."""
FARTHEST = 37.0
"""Largest score: beyond it probabilities underflow."""


def normal_scores(e: Tensor, freedom: Tensor, variance: Tensor | None = None) -> Tensor:
    """Return standard normal numbers for residuals whose noise is Student's, of the same shape.

    Args:
        e: residuals in scales of the noise, (..., M); 0 stays 0.
        freedom: degrees of freedom, (M,), inf for normal noise.
        variance: variance of an additional independent normal error, in squared scales, (..., M); None for
            none.
    """
    nu = freedom.expand_as(e)
    tail = _tail(e.abs(), nu) if variance is None else _mixed_tail(e.abs(), nu, variance)
    normal = e.abs() if variance is None else e.abs() / (1 + variance).sqrt()
    size = torch.where(nu.isinf(), normal, -torch.special.ndtri(tail).clamp(-FARTHEST, 0.0))
    return e.sign() * size


def _tail(size: Tensor, nu: Tensor) -> Tensor:
    """Return the probability of noise above a size."""
    from scipy.special import stdtr

    return torch.as_tensor(stdtr(nu.numpy(), -size.numpy()))


def _mixed_tail(size: Tensor, nu: Tensor, variance: Tensor) -> Tensor:
    """Return the probability of noise and error above a size, by the trapezoidal rule over g."""
    from scipy.special import gammaincinv

    nodes = torch.linspace(-REACH, REACH, NODES, dtype=torch.float64)
    weights = torch.exp(-nodes.square() / 2)
    weights = weights / weights.sum()
    kinds, which = nu.unique(return_inverse=True)
    half = torch.nan_to_num(kinds / 2, posinf=1.0).unsqueeze(-1)
    precisions = torch.as_tensor(gammaincinv(half.numpy(), torch.special.ndtr(nodes).numpy())) / half
    total = torch.zeros_like(size)
    for k, weight in enumerate(weights):
        total = total + weight * torch.special.ndtr(-size / (1 / precisions[which, k] + variance).sqrt())
    return total
