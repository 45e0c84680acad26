"""Maximum a posteriori steps on all measurements, with a prior on the parameters."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.measurements import Segment
from ahnn.shooting.initial_states import FOLLOWING, SURE, refine
from ahnn.shooting.quadrature import coarse
from ahnn.shooting.robust import Robust
from ahnn.training.evidence import Prior, determined, posterior_factor
from ahnn.training.normal_equations import Block
from ahnn.training.shooting import Limit, ShootingProblem, freedom


class WideProblem(ShootingProblem):
    """Shooting problem with float64 normal equations, which preserve poorly determined directions."""

    precision = torch.float64

    @torch.no_grad()
    def follow(self, theta: Tensor) -> None:
        """Refit the initial states after a step to theta, shape (P,)."""
        near = self.refitted(theta).starts
        fitted = refine(self.trial(theta), near, self.batch, self.steps, FOLLOWING, SURE)
        self._linear = None
        self.starts, self.limit = fitted.starts, Limit.of(fitted.sums, freedom(self.batch))


def whole_problem(dynamics: Dynamics, batch: Segment, robust: Robust) -> WideProblem:
    """Build the problem of all segments, with quartered integrator steps if J is otherwise too inaccurate."""
    problem = WideProblem(dynamics, batch, robust)
    states = problem.fitted.states[problem.kept]
    if not coarse(cast(HasField, dynamics).field, states, problem.steps.lengths):
        return problem
    return WideProblem(dynamics, batch, robust, starts=problem.fitted.starts, quartered=True)


def after(problem: WideProblem, dynamics: Dynamics) -> WideProblem:
    """Build the problem of the same segments for similar dynamics."""
    quartered = problem.steps.quartered
    return WideProblem(dynamics, problem.batch, problem.robust, starts=problem.starts, quartered=quartered)


@torch.no_grad()
def of_functions(problem: WideProblem, dynamics: Dynamics, origin: Tensor, weights: Tensor) -> Block:
    """Return the normal equations in the P parameters in which the functions are linear.

    Args:
        problem: problem of the functions.
        dynamics: dynamics about which they are linearised.
        origin: parameters of these dynamics, shape (P,).
        weights: parameters of the functions.
    """
    own, rows = problem.forcing, field_jacobian(cast(HasField, dynamics), problem.precision)
    problem.forcing = lambda _, states: rows(origin, states)
    _, _, (block,) = problem.equations(weights, [])
    problem.forcing = own
    return block


def with_prior(block: Block, prior: Prior, theta: Tensor) -> Block:
    """Return the normal equations of residuals and prior at theta, shape (P,)."""
    precision = prior.precision
    matrix = block.matrix + torch.diag(precision)
    return block._replace(matrix=matrix, gradient=block.gradient + precision * theta)


class PosteriorPoint(NamedTuple):
    """Quadratic model of residuals and prior about given parameters.

    Attributes:
        theta: (P,) parameters.
        loss, degrees, block: quantities of the residuals, as in `Equations`.
        prior: prior of maximum evidence at the beginning of function-space steps.
        factor: L, (P, P); L L^T is the inverse of the matrix of residuals and prior.
        determined: number of parameters that the data determine.
        pull: (P,) gradient of half the sum in posterior standard units: theta = ... + L u.
    """

    theta: Tensor
    loss: Tensor
    degrees: int
    block: Block
    prior: Prior
    factor: Tensor
    determined: float
    pull: Tensor

    @classmethod
    def of(cls, theta: Tensor, loss: Tensor, degrees: int, block: Block, prior: Prior) -> PosteriorPoint:
        """Build the point with its factor and gradient."""
        factor = posterior_factor(block.matrix, prior)
        pull = factor.mT @ (block.gradient + prior.precision * theta)
        return cls(theta, loss, degrees, block, prior, factor, float(determined(factor, prior).sum()), pull)

    @property
    def offset(self) -> Tensor:
        """Step (P,) to the optimum."""
        return -self.factor @ self.pull

    @property
    def remaining(self) -> float:
        """Squared length of that step in standard deviations, equal to its predicted decrease."""
        return float(self.pull @ self.pull)

    @property
    def chi_square(self) -> float:
        """Squared residuals per degree of freedom."""
        return float(self.loss) / max(self.degrees - self.determined, 1.0)

    @property
    def objective(self) -> float:
        """Sum of squared residuals and prior contribution."""
        return float(self.loss + self.prior.penalty(self.theta))

    def moved(self, theta: Tensor, loss: Tensor, gradient: Tensor) -> PosteriorPoint:
        """Return another point with the same matrix, from its J^T r, shape (P,)."""
        pull = self.factor.mT @ (gradient + self.prior.precision * theta)
        return self._replace(theta=theta, loss=loss, pull=pull, block=self.block._replace(gradient=gradient))

    def left(self, promised: float) -> PosteriorPoint:
        """Return the point with its remaining step limited to a predicted decrease."""
        part = min(max(promised / self.remaining, 0.0), 1.0) if self.remaining > 0 else 0.0
        return self._replace(pull=part**0.5 * self.pull)
