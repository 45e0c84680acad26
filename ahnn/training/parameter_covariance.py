"""Covariance of the parameters at the end of a training on measurements, widened where they require it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.shooting.robust import variance
from ahnn.training.evidence import log_evidence
from ahnn.training.limited_segments import freedom
from ahnn.training.maximum_posterior import PosteriorPoint, WideProblem
from ahnn.training.normal_equations import Equations
from ahnn.uncertainty import Uncertainty

REFUSED = 3.0902
"""Standard deviations above the expectation at which a factor is rejected: 99.9 %, one-sided.

With 95 % the noise of held-out measurements would widen the bands of one correct model in twenty.
"""


class Noise(NamedTuple):
    """Noise statistics of training residuals, in addition to the mean cost per degree of freedom.

    Attributes:
        widening: factor on the covariance, 1 for squares (`ahnn.shooting.robust.variance`).
        scatter: variance of a residual's contribution to the sum.
        uneven: largest cost per degree of freedom of a segment, relative to the median, or to 1 if that is
            less: large if a segment has lost its path.
    """

    widening: float
    scatter: float
    uneven: float = 1.0

    @classmethod
    def of(cls, problem: WideProblem, theta: Tensor) -> Noise:
        """Estimate the noise of a problem at theta, shape (P,)."""
        fitted = problem.refitted(theta)
        residuals = problem.batch.white_residuals(fitted.states[:, problem.steps.ends])
        sums, degrees = problem.limit.cost(fitted.sums), freedom(problem.batch)
        costs = fitted.sums / degrees
        uneven = float(costs.max() / costs.median().clamp(min=1.0))
        return cls(variance(problem.robust, residuals), scatter(sums, degrees), uneven)


def scatter(sums: Tensor, degrees: Tensor) -> float:
    """Estimate the variance of a residual's contribution to the sum from the sums of segments.

    For squares of normally distributed residuals of variance v it is 2 v^2. The result is never smaller,
    because a few segments may agree by chance. Outliers make it several times larger, even with a robust
    loss.

    Args:
        sums: sums of segments, (B,).
        degrees: degrees of freedom of segments, (B,).
    """
    typical = sums.sum() / degrees.sum()
    found = (sums - typical * degrees).square().sum() / degrees.sum()
    return float(torch.maximum(found, 2 * typical**2))


def uncertainty(here: PosteriorPoint, held_out: Equations, names: Sequence[str], noise: Noise) -> Uncertainty:
    """Return the covariance at a point, widened as required by the held-out measurements.

    Args:
        here: final point of the training.
        held_out: quadratic model of the held-out measurements.
        names: names of the parameter groups.
        noise: noise statistics of the training.
    """
    inflation = max(here.chi_square * noise.widening, 1.0)
    spread = Uncertainty(here.factor, here.offset, inflation, {}).spread
    unexplained = held_out_scale(spread, held_out, here.chi_square, noise.scatter)
    about = {
        "parameters": len(here.theta),
        "determined": here.determined,
        "chi_square": here.chi_square,
        "remaining": here.remaining,
        "uneven": noise.uneven,
        "held_out": unexplained,
        "strengths": dict(zip(names, here.prior.strengths.tolist(), strict=True)),
        "log_evidence": log_evidence(here.block.matrix, here.loss, here.degrees, here.theta, here.prior),
    }
    return Uncertainty(here.factor, here.offset, inflation * unexplained, about)


def held_out_scale(factor: Tensor, test: Equations, noise: float, scatter: float) -> float:
    """Return the least factor >= 1 on a covariance L L^T that held-out measurements do not reject.

    If theta has error N(0, f L L^T), the expected sum of squares of n residuals with noise variance v is n v
    + f tr M, M = L^T J^T J L, with variance n s + 2 (2 v f tr M + f^2 tr M^2), where s is the variance of a
    square. The observed sum is `REFUSED` standard deviations above the expectation for the f returned.

    Args:
        factor: L, shape (P, R).
        test: quadratic model of the held-out measurements.
        noise: v, estimated by the training.
        scatter: s, estimated by the training.
    """
    if not test.blocks:
        return 1.0
    predicted = factor.mT @ test.blocks[0].matrix @ factor
    expected, squares = float(predicted.diagonal().sum()), float(predicted.square().sum())
    excess = float(test.loss) - test.degrees * noise
    beyond = excess**2 - REFUSED**2 * test.degrees * scatter
    if excess <= 0 or beyond <= 0:
        return 1.0
    # The root of a f^2 - 2 b f + c = 0 for which the observed sum exceeds the expectation.
    a, b = expected**2 - 2 * REFUSED**2 * squares, expected * (excess + 2 * REFUSED**2 * noise)
    return max(1.0, beyond / (b + (b**2 - a * beyond) ** 0.5))
