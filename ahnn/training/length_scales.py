"""The lengths of a Gaussian process by the evidence of the measurements, before the last steps of a training.

Steps of the parameters fit lengths as they fit weights: the shorter they are, the less is left of the noise.
The evidence p(measurements | lengths, strength), weights integrated out, is largest where the process is as
smooth as the measurements allow (Rasmussen & Williams 2006, chapter 5). Predicted measurements are linear in
the weights of the waves along the paths that fit, so that it has a closed form there, in the residuals y that
no weights would leave and what weights move them by, J:

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
"""Times that paths are fitted and lengths found along them."""
FACTORS = (4.0, 2.0, 1.4)
"""By which lengths are tried longer and shorter, from coarse to fine."""
LONGEST = 30.0
"""In half ranges of the states: what is longer is a polynomial of low degree there, to rounding."""
STRENGTHS = [10.0**power for power in range(-10, 7)]
"""Of the prior on the weights, that are tried."""
OPEN = 1e-6
"""Strength of the prior on what else is learned, which is no hyperparameter here."""


class Posterior(NamedTuple):
    """Log evidence of some lengths, and the parameters (P,) that are most probable with them."""

    evidence: float
    theta: Tensor


@torch.no_grad()
def choose_lengths(dynamics: Dynamics, train: Segment, robust: Robust) -> None:
    """Set and hold the lengths of the largest evidence, and the weights that are most probable with them.

    Args:
        dynamics: with a field; without waves nothing happens.
        train: all measurements of the training.
        robust: the loss of single residuals.
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
    """Return which parameters (P,) are lengths."""
    return chosen(dynamics, lambda name: name.endswith("log_lengths"))


def search(posterior: Callable[[Tensor], Posterior], theta: Tensor, lengths: Tensor) -> Posterior:
    """Return the best that trying longer and shorter lengths finds, all together and each alone.

    Args:
        posterior: of parameters (P,) whose lengths are tried.
        theta: to begin with.
        lengths: which parameters are lengths, (P,).
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
    """The measurements along paths that fit, as they depend on lengths and weights."""

    def __init__(self, problem: WideProblem, dynamics: Dynamics) -> None:
        self.problem = problem
        self.rows = field_jacobian(cast(HasField, dynamics), problem.precision)
        self.here = parameters_to_vector(dynamics.parameters())
        self.lengths, self.linear = lengths_of(dynamics), linear_in(dynamics)

    def posterior(self, theta: Tensor) -> Posterior:
        """Return the evidence of the lengths of theta, (P,), largest over strengths, and the best weights."""
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
    """Return log p but for a constant; -inf where it has no digits left.

    Args:
        matrix: J^T J, (P, P).
        b: J^T y, (P,).
        waves: which parameters are weights of waves, (P,).
        alpha: strength of their prior.
    """
    factor, wrong = torch.linalg.cholesky_ex(matrix + (alpha * waves).diag())
    if int(wrong):
        return -math.inf
    left = torch.linalg.solve_triangular(factor, b.unsqueeze(-1), upper=False)
    volume = factor.diagonal().log().sum() - 0.5 * int(waves.sum()) * math.log(alpha)
    return float(0.5 * left.square().sum() - volume)


def linear_in(dynamics: Dynamics) -> Tensor:
    """Return which parameters (P,) are weights of waves, in which the field is linear."""
    networks = [name.removesuffix("hidden.0") for name, m in dynamics.named_modules() if isinstance(m, Waves)]
    return chosen(dynamics, lambda name: name in {f"{network}output.weight" for network in networks})


def chosen(dynamics: Dynamics, named: Callable[[str], bool]) -> Tensor:
    """Return which parameters (P,) have a name that is asked for."""
    parts = [torch.full((p.numel(),), named(name)) for name, p in dynamics.named_parameters()]
    return torch.cat(parts)
