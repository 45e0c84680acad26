"""How well the parameters are known at the end of a training on measurements (Laplace's approximation).

The covariance is the inverse of J^T J over all training measurements, starts eliminated, and the prior. What
noise alone gives is then held against three things that no truth is needed for:

- chi-square of the training per degree of freedom, where it exceeds 1: the noise is larger than was said, or
  the model does not reach the data;
- the step to the optimum that is left, -H^-1 g: a training that ended early is off by that much, too;
- held-out measurements: if they pull at the parameters by more than both explain, by as much more.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.training.evidence import by_evidence, determined, log_evidence, posterior_factor
from ahnn.training.normal_equations import Block
from ahnn.training.posterior import WideProblem
from ahnn.uncertainty import Uncertainty

SCALES = torch.logspace(0, 6, 601, dtype=torch.float64)
"""Factors on the covariance that are compared."""
REFUSED = 1.353
"""Gain in log-likelihood that a factor above 1 must bring: 1 is then refused with 95 %, one-sided."""


def laplace(
    dynamics: Dynamics, train: Segment, held_out: Segment, robust: RobustName = "none"
) -> Uncertainty | None:
    """Return the covariance of the parameters; None if no trajectory is explained.

    With a robust loss its mean takes the place of chi-square, which outliers raise: the covariance is then on
    the safe side.

    Args:
        dynamics: with a field, float64, as they were trained.
        train: all measurements of the training.
        held_out: measurements that no step was taken on.
        robust: the loss of single residuals.
    """
    parameters = list(dynamics.parameters())
    theta, sizes = parameters_to_vector(parameters).detach(), [p.numel() for p in parameters]
    loss, degrees, blocks = WideProblem(dynamics, train, ROBUST[robust]).equations(theta, sizes)
    _, _, other = WideProblem(dynamics, held_out, ROBUST[robust]).equations(theta, sizes)
    if not blocks or not other:
        return None
    (block,), (test,) = blocks, other
    prior = by_evidence(block.matrix, theta, sizes)
    factor = posterior_factor(block.matrix, prior)
    gamma = float(determined(factor, prior).sum())
    chi_square = float(loss) / max(degrees - gamma, 1.0)
    offset = -factor @ (factor.mT @ (block.gradient + prior.precision * theta))
    inflation = max(chi_square, 1.0)
    spread = Uncertainty(factor, offset, inflation, {}).spread
    unexplained = held_out_scale(spread, test)
    names = [name for name, _ in dynamics.named_parameters()]
    about = {
        "determined": gamma,
        "parameters": len(theta),
        "chi_square": chi_square,
        "remaining": float(offset @ (block.matrix @ offset + prior.precision * offset)),
        "held_out": unexplained,
        "strengths": dict(zip(names, prior.strengths.tolist(), strict=True)),
        "log_evidence": log_evidence(block.matrix, loss, int(train.measured.sum()), theta, prior),
    }
    return Uncertainty(factor, offset, inflation * unexplained, about)


def held_out_scale(factor: Tensor, test: Block) -> float:
    """Return the factor on a covariance L L^T that held-out measurements ask for; 1 unless they refuse it.

    If theta is off by N(0, f L L^T), the gradient g = J^T r of other measurements is N(0, A + f A L L^T A)
    with A = J^T J. In the eigenvectors of L^T A L, with eigenvalues m, the components of L^T g are
    independent, of variance m + f m^2.

    Args:
        factor: L, shape (P, R).
        test: matrix A and gradient g of the held-out measurements.
    """
    sizes, vectors = torch.linalg.eigh(factor.mT @ test.matrix @ factor)
    told = sizes > 1e-9 * sizes[-1]
    m, pull = sizes[told], (vectors.mT @ (factor.mT @ test.gradient))[told]
    variance = m + SCALES.unsqueeze(-1) * m * m
    likelihood = -0.5 * (variance.log() + pull.square() / variance).sum(-1)
    best = int(likelihood.argmax())
    return float(SCALES[best]) if float(likelihood[best] - likelihood[0]) > REFUSED else 1.0
