"""Degrees of freedom and scale of Student's noise from residuals, by maximum likelihood.

The log likelihood of n residuals e with the scale s and nu degrees of freedom is

    sum log Gamma((nu + 1) / 2) - log Gamma(nu / 2) - log(pi nu s^2) / 2 - (nu + 1) / 2 log(1 + e^2 / nu s^2).

For given nu the scale is the fixed point of expectation and maximisation, s^2 = sum w e^2 / n with the
weights w = (nu + 1) / (nu + e^2 / s^2) (Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881-896). Here
both are found jointly by a quasi-Newton method. The Fisher information of a residual about s and nu has a
closed form (ibid., appendix B).

A fit makes residuals smaller, most of all small ones: of a value with weight w and derivatives x with respect
to the unknowns, it absorbs the fraction h = c w x^T (sum w x x^T)^-1 x, where c = (nu + 3) / (nu + 1) is the
mean weight divided by the mean curvature of the loss. Residuals divided by (1 - h)^1/2 are distributed like
the noise, to first order in h; for normal noise h is the leverage, whose sum is the trace of the hat matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.data.noise_floor import NORMAL
from ahnn.shooting.robust import information

FEWEST, MOST = 0.5, 1e3
"""Range of the degrees of freedom; noise with more is normal."""
STARTS = (3.0, 30.0)
"""Degrees of freedom from which the search begins."""
TELLING = 7.88
"""Twice the gain in log likelihood over normal noise above which tails are heavy. It occurs by chance in 0.25
% of cases, since nu = inf is the end of the range.
"""
NORMAL95, ONE_SIDED = 1.959964, 1.644854
"""Two-sided and one-sided 95 % limits of a normal distribution, in standard deviations."""
LEAST = 50
"""Minimum number of residuals for an estimate."""
SMALLEST = 0.1
"""Lower limit of 1 - h."""


class FoundTails(NamedTuple):
    """Noise of one measured component.

    Attributes:
        scale: s, or the standard deviation where the noise is normal.
        scale_sd: standard deviation of s.
        freedom: nu; inf where the noise cannot be distinguished from normal noise.
        low, high: ends of the 95 % interval of nu; where the noise cannot be distinguished from normal noise,
            a limit that nu exceeds with 95 % probability, and inf.
    """

    scale: float
    scale_sd: float
    freedom: float
    low: float
    high: float


def without_fit(residuals: Tensor, of_start: Tensor, freedom: Tensor | None) -> Tensor:
    """Return residuals (B, T, M), corrected for the effect of fitted initial states.

    Args:
        residuals: residuals in the noise scales of the fit.
        of_start: their derivatives with respect to the initial states, times the square roots of the weights,
            (B, T, M, D).
        freedom: degrees of freedom of the fit, (M,); None for squares.
    """
    taken = torch.linalg.qr(of_start.flatten(1, 2)).Q.square().sum(-1).view_as(residuals)
    taken = taken if freedom is None else taken / information(freedom)
    return residuals / (1 - taken).clamp(min=SMALLEST).sqrt()


def most_likely_tails(e: Tensor) -> FoundTails:
    """Return the most likely Student's or normal noise of residuals (n,) about 0, with its uncertainty.

    Args:
        e: residuals, in any unit.
    """
    n, normal = len(e), float(e.square().mean().sqrt())
    if n < LEAST or not normal > 0:
        return FoundTails(normal, 0.0, math.inf, 0.0, math.inf)
    unit = float(e.abs().median()) / NORMAL or normal
    scale, freedom, gain = _searched(e / unit)
    of_scale, of_freedom = deviations_of(freedom, n)
    if gain < TELLING:
        rate = 1 / freedom + ONE_SIDED * of_freedom / freedom**2
        return FoundTails(normal, normal / (2 * n) ** 0.5, math.inf, 1 / rate, math.inf)
    spread = math.exp(NORMAL95 * of_freedom / freedom)
    scale = scale * unit
    return FoundTails(scale, scale * of_scale, freedom, freedom / spread, freedom * spread)


def deviations_of(freedom: float, count: float) -> tuple[float, float]:
    """Return the standard deviations of the logarithm of the scale, and of nu, for a number of residuals."""
    nu, half = freedom, torch.tensor([freedom / 2, (freedom + 1) / 2], dtype=torch.float64)
    first, second = torch.special.polygamma(1, half).tolist()
    of_scale, both = 2 * nu / (nu + 3), -2 / ((nu + 1) * (nu + 3))
    of_freedom = (first - second) / 4 - (nu + 5) / (2 * nu * (nu + 1) * (nu + 3))
    determinant = count * (of_scale * of_freedom - both**2)
    return (of_freedom / determinant) ** 0.5, (of_scale / determinant) ** 0.5


def _searched(e: Tensor) -> tuple[float, float, float]:
    """Return scale, nu, and twice the gain in log likelihood over normal noise, of residuals (n,)."""
    from scipy.optimize import minimize  # the import takes a fifth of a second

    def value(found: object) -> tuple[float, object]:
        at = torch.tensor(found, dtype=torch.float64, requires_grad=True)
        with torch.enable_grad():
            cost = -2 * student_likelihood(e, at[0].exp(), at[1].exp()) / len(e)
            (slope,) = torch.autograd.grad(cost, at)
        return float(cost.detach()), slope.numpy()

    limits = [(-20.0, 20.0), (math.log(FEWEST), math.log(MOST))]
    ends = {"ftol": 1e-13, "gtol": 1e-9}
    tried = [
        minimize(value, (0.0, math.log(nu)), jac=True, method="L-BFGS-B", bounds=limits, options=ends)
        for nu in STARTS
    ]
    best = min(tried, key=lambda one: one.fun)
    normal = math.log(2 * math.pi * float(e.square().mean())) + 1
    return math.exp(best.x[0]), math.exp(best.x[1]), len(e) * (normal - float(best.fun))


def student_likelihood(e: Tensor, scale: Tensor, freedom: Tensor) -> Tensor:
    """Return the log likelihood of residuals (n,)."""
    half = freedom / 2
    constant = torch.lgamma(half + 0.5) - torch.lgamma(half) - 0.5 * (math.pi * freedom).log() - scale.log()
    return len(e) * constant - (half + 0.5) * torch.log1p((e / scale).square() / freedom).sum()
