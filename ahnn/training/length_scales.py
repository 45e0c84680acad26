"""Length scales of a Gaussian process by maximum evidence, before the final steps of the training.

Parameter steps fit lengths like weights: shorter lengths fit more of the noise. The evidence p(measurements |
lengths, strength), with weights integrated out, is largest for the smoothest process that the measurements
allow (Rasmussen & Williams 2006, chapter 5). Along the fitted paths, predicted measurements are linear in the
weights of the waves, so that the evidence has a closed form in the residuals y at zero weights and their
Jacobian J:

    log p = b^T (J^T J + alpha)^-1 b / 2 - log det(J^T J + alpha) / 2 + K log(alpha) / 2,    b = J^T y
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.gaussian_process import Waves
from ahnn.measurements import Segment
from ahnn.shooting.robust import Robust
from ahnn.training.maximum_posterior import WideProblem, after, whole_problem

ROUNDS = 3
"""Number of alternations between fits of paths and of lengths."""
FACTORS = (4.0, 2.0, 1.4)
"""Factors by which longer and shorter lengths are tried, from coarse to fine."""
LONGEST = 30.0
"""Upper limit of lengths, in half ranges of the states; longer ones give low-degree polynomials."""
STRENGTHS = [10.0**power for power in range(-10, 7)]
"""Candidate precisions of the prior on the weights."""
OPEN = 1e-6
"""Fixed precision of the prior on other learned parameters, relative to the diagonal of J^T J."""


class Posterior(NamedTuple):
    """Log evidence of given lengths, and the most probable parameters (P,)."""

    evidence: float
    theta: Tensor


@torch.no_grad()
def choose_lengths(dynamics: Dynamics, train: Segment, robust: Robust) -> None:
    """Set and freeze the lengths of maximum evidence, and set the most probable weights.

    Args:
        dynamics: dynamics with a field; unchanged without waves.
        train: all training measurements.
        robust: robust loss of residuals.
    """
    waves = [module for module in dynamics.modules() if isinstance(module, Waves)]
    if not waves:
        return
    parameters = list(dynamics.parameters())
    problem = whole_problem(dynamics, train, robust)
    for _ in range(ROUNDS):
        if not len(problem.starts):
            return
        found = search(
            Along(problem, dynamics).posterior, parameters_to_vector(parameters), lengths_of(dynamics)
        )
        vector_to_parameters(found.theta, parameters)
        problem = after(problem, dynamics)
    for one in waves:
        one.hold()


def lengths_of(dynamics: Dynamics) -> Tensor:
    """Return the mask of length parameters, (P,)."""
    return chosen(dynamics, lambda name: name.endswith("log_lengths"))


def search(posterior: Callable[[Tensor], Posterior], theta: Tensor, lengths: Tensor) -> Posterior:
    """Search lengths by factors, jointly and individually, and return the best.

    Args:
        posterior: evidence as a function of parameters (P,).
        theta: initial parameters.
        lengths: mask of length parameters, (P,).
    """
    own = torch.eye(len(theta)).to(theta)[lengths]
    directions = [own.sum(0), *own] if len(own) > 1 else [*own]
    best, logs = posterior(theta), theta * lengths
    for factor in FACTORS:
        step = math.log(factor)
        for direction in directions:
            for sign in (1, -1):
                while True:
                    tried = (logs + sign * step * direction).clamp(max=math.log(LONGEST))
                    found = posterior(torch.where(lengths, tried, theta))
                    if not found.evidence > best.evidence + 0.1:
                        break
                    best, logs = found, tried
    return best


class Along:
    """Measurements along fitted paths as functions of lengths and weights."""

    def __init__(self, problem: WideProblem, dynamics: Dynamics) -> None:
        self.problem = problem
        self.rows = field_jacobian(cast(HasField, dynamics), problem.precision)
        self.here = parameters_to_vector(dynamics.parameters())
        self.lengths, self.linear = lengths_of(dynamics), linear_in(dynamics)

    def posterior(self, theta: Tensor) -> Posterior:
        """Return the evidence of the lengths in theta, (P,), for the best precision, and the best weights."""
        free, own = ~self.lengths, self.problem.forcing
        weights = torch.where(self.linear, self.here, 0.0)

        def forcing(_: Tensor, states: Tensor) -> Tensor:
            now = self.rows(self.here, states) @ weights
            return torch.cat((self.rows(theta, states)[..., free], now.unsqueeze(-1)), dim=-1)

        self.problem.forcing = forcing
        _, _, (block,) = self.problem.equations(self.here, [])
        self.problem.forcing = own
        matrix, b = block.matrix[:-1, :-1], block.matrix[:-1, -1] - block.gradient[:-1]
        waves, rounding = self.linear[free], len(b) * torch.finfo(b.dtype).eps
        sizes = matrix.diagonal()
        matrix = matrix + torch.where(waves, rounding * sizes, OPEN * sizes).diag()
        found, alpha = max((evidence(matrix, b, waves, alpha), alpha) for alpha in STRENGTHS)
        if not math.isfinite(found):
            return Posterior(-math.inf, theta)
        factor = torch.linalg.cholesky(matrix + (alpha * waves).diag())
        best = torch.cholesky_solve(b.unsqueeze(-1), factor).squeeze(-1)
        reached = theta.clone()
        reached[free] = best + torch.where(waves, 0.0, self.here[free])
        return Posterior(found, reached)


def evidence(matrix: Tensor, b: Tensor, waves: Tensor, alpha: float) -> float:
    """Return log p up to a constant; -inf if the matrix is singular to rounding.

    Args:
        matrix: J^T J, (P, P).
        b: J^T y, (P,).
        waves: mask of wave weights, (P,).
        alpha: precision of their prior.
    """
    factor, wrong = torch.linalg.cholesky_ex(matrix + (alpha * waves).diag())
    if int(wrong):
        return -math.inf
    left = torch.linalg.solve_triangular(factor, b.unsqueeze(-1), upper=False)
    volume = factor.diagonal().log().sum() - 0.5 * int(waves.sum()) * math.log(alpha)
    return float(0.5 * left.square().sum() - volume)


def linear_in(dynamics: Dynamics) -> Tensor:
    """Return the mask of wave weights, (P,), in which the field is linear."""
    networks = [name.removesuffix("hidden.0") for name, m in dynamics.named_modules() if isinstance(m, Waves)]
    return chosen(dynamics, lambda name: name in {f"{network}output.weight" for network in networks})


def chosen(dynamics: Dynamics, named: Callable[[str], bool]) -> Tensor:
    """Return the mask of parameters (P,) with given names."""
    parts = [torch.full((p.numel(),), named(name)) for name, p in dynamics.named_parameters()]
    return torch.cat(parts)
