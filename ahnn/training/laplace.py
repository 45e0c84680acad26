"""The end of a training on measurements: its last steps on all of them, and how well they determine it.

With all measurements in every step there is no noise of mini-batches left: Gauss-Newton steps on residuals
and prior lead to the optimum. Parameters follow a bent valley there, in many short steps; functions do not,
so that the last step is taken by them (`ahnn.dynamics.linearised`): the Gauss-Newton step to the optimum,
whole, with the prior of the largest evidence there. The covariance of the parameters is the inverse of J^T J,
starts eliminated, and the prior (Laplace's approximation). Three things that no truth is needed for may
widen it:

- chi-square of the training per degree of freedom, where it exceeds 1: the noise is larger than was said, or
  the model does not reach the data;
- what the last step did not gain of what it promised: the training is off by that much of it, too;
- held-out measurements: if the model leaves more of them unexplained than both account for, by that ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics
from ahnn.dynamics.linearised import linearised
from ahnn.measurements import Segment
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.training.acceleration import accelerated
from ahnn.training.evidence import Prior, by_evidence, determined, log_evidence, posterior_factor
from ahnn.training.levenberg_marquardt import ATTEMPTS, LARGEST, SUFFICIENT, adapted
from ahnn.training.normal_equations import Block, Equations, damped_step, promised_decrease
from ahnn.training.posterior import WideProblem, with_prior
from ahnn.uncertainty import Uncertainty

ARRIVED = 0.05
"""Squared length of the step that is left, or decrease by the last one, that is not worth another step.

As a share of what noise alone gives: 1 for each parameter that the data determine.
"""
DAMPING = 1e-6
"""Of the first step: a training in float32 has left what is seen a millionth as well as the rest."""
HARDER = 10.0
"""Times the damping, for a step that went beyond its bend."""
REFUSED = 1.645
"""Standard deviations above what a factor of 1 leads to: it is then refused with 95 %, one-sided."""


class Place(NamedTuple):
    """Residuals and prior to second order about some parameters.

    Attributes:
        theta: (P,).
        loss, degrees, block: of the residuals, as in `Equations`.
        prior: the one of the largest evidence.
        factor: L, (P, P); L L^T is the inverse of the matrix of residuals and prior.
        determined: number of parameters that the data determine.
        offset: (P,) the step to the optimum.
        remaining: its squared length in standard deviations, which is what it promises to gain.
    """

    theta: Tensor
    loss: Tensor
    degrees: int
    block: Block
    prior: Prior
    factor: Tensor
    determined: float
    offset: Tensor
    remaining: float

    @classmethod
    def of(cls, theta: Tensor, loss: Tensor, degrees: int, block: Block, prior: Prior) -> Place:
        """Return the place, its factor and optimum worked out."""
        factor = posterior_factor(block.matrix, prior)
        pull = factor.mT @ (block.gradient + prior.precision * theta)
        count = float(determined(factor, prior).sum())
        return cls(theta, loss, degrees, block, prior, factor, count, -factor @ pull, float(pull @ pull))

    def linear(self) -> Place:
        """Return the place with the prior of residuals that are linear in the parameters, at its optimum."""
        prior = by_evidence(self.block.matrix, self.theta, self.prior.sizes, self.block.gradient)
        return self.of(self.theta, self.loss, self.degrees, self.block, prior)

    @property
    def chi_square(self) -> float:
        """Squared residuals per degree of freedom."""
        return float(self.loss) / max(self.degrees - self.determined, 1.0)

    def left(self, promised: float) -> Place:
        """Return the place with a step to the optimum that promises no more than this."""
        part = min(max(promised / self.remaining, 0.0), 1.0) if self.remaining > 0 else 0.0
        return self._replace(offset=part**0.5 * self.offset, remaining=part * self.remaining)


@torch.no_grad()
def conclude(
    dynamics: Dynamics, train: Segment, held_out: Segment, steps: int, robust: RobustName = "none"
) -> Uncertainty | None:
    """Take the last steps of a training and return the covariance of the parameters that it ended at.

    With a robust loss its mean takes the place of chi-square, which outliers raise: the covariance is then on
    the safe side.

    Args:
        dynamics: with a field, float64; their parameters are moved.
        train: all measurements of the training.
        held_out: measurements that no step was taken on.
        steps: at most so many.
        robust: the loss of single residuals.

    Returns:
        None if no trajectory is explained; the parameters then stay where they are.
    """
    problem, here, gained = approached(dynamics, train, steps, robust)
    if here is None:
        return None
    unseen = WideProblem(dynamics, held_out, ROBUST[robust])
    others = unseen.equations(here.theta, [p.numel() for p in dynamics.parameters()])
    names = [name for name, _ in dynamics.named_parameters()]
    taken = whole_step(problem, dynamics, here)
    if taken is None:
        there = here.left(gained) if gained <= ARRIVED * here.determined else here
        return uncertainty(there, others, names)
    wide, there = taken
    others = others._replace(loss=after(unseen, wide).cost)
    return replace(uncertainty(there, others, names), step=there.theta - here.theta)


def approached(
    dynamics: Dynamics, train: Segment, steps: int, robust: RobustName
) -> tuple[WideProblem, Place | None, float]:
    """Take steps of the parameters; return problem and place where they end, and what the last one gained."""
    parameters = list(dynamics.parameters())
    sizes = [p.numel() for p in parameters]
    problem = WideProblem(dynamics, train, ROBUST[robust])
    here = place(problem, parameters_to_vector(parameters), sizes)
    damping, gained = DAMPING, float("inf")
    for _ in range(steps):
        if here is None or min(here.remaining, gained) <= ARRIVED * here.determined:
            break
        theta, damping, decrease = lower(problem, here, damping)
        if theta is None:
            break
        gained = decrease
        vector_to_parameters(theta, parameters)
        if problem.lost:  # what did not converge before may do so now
            problem = WideProblem(dynamics, train, ROBUST[robust])
        else:
            problem.follow(theta)
        here = place(problem, theta, sizes)
    return problem, here, gained


def whole_step(problem: WideProblem, dynamics: Dynamics, start: Place) -> tuple[Dynamics, Place] | None:
    """Return dynamics whose functions took the step to the optimum, and the place where they are.

    With the prior that residuals linear in the parameters ask for; where that leads too far, with the one of
    the parameters as they are. None where functions cannot take it, or where it does not pay.
    """
    if start.remaining <= ARRIVED * start.determined:
        return None
    for here in (start.linear(), start):
        found, theta = linearised(dynamics, here.offset), here.theta + here.offset
        if found is None:
            return None
        moved = after(problem, found[0])
        paid = here.prior.penalty(here.theta) - here.prior.penalty(theta)
        left = here.remaining - float(here.loss - moved.cost + paid)
        if not moved.lost and left < (1 - SUFFICIENT) * start.remaining:
            rest = start.left(left)
            there = here._replace(theta=theta, loss=moved.cost, offset=rest.offset, remaining=rest.remaining)
            return found[0], there
    return None


def after(problem: WideProblem, dynamics: Dynamics) -> WideProblem:
    """Return the same segments for similar dynamics."""
    return WideProblem(dynamics, problem.batch, problem.robust, starts=problem.starts)


def place(problem: WideProblem, theta: Tensor, sizes: Sequence[int]) -> Place | None:
    """Return the problem to second order at theta, shape (P,); None if nothing depends on it."""
    loss, degrees, blocks = problem.equations(theta, sizes)
    if not blocks:
        return None
    (block,) = blocks
    return Place.of(theta, loss, degrees, block, by_evidence(block.matrix, theta, sizes))


def lower(problem: WideProblem, here: Place, damping: float) -> tuple[Tensor | None, float, float]:
    """Return parameters (P,) after a step that lowers residuals and prior; a damping; the decrease.

    None for the parameters where no step lowers them.
    """
    block = with_prior(here.block, here.prior, here.theta)
    before = here.loss + here.prior.penalty(here.theta)
    for _ in range(ATTEMPTS):
        straight = damped_step([block], damping, here.theta)
        move = straight if straight is None else accelerated(problem, here.theta, [block], straight, damping)
        if straight is None or move is None:
            damping = min(damping * HARDER, LARGEST)
            continue
        theta = here.theta + move
        decrease = float(before - problem.loss(theta) - here.prior.penalty(theta))
        gain = decrease / float(promised_decrease([block], straight))
        accepted = gain > SUFFICIENT
        damping = adapted(damping, gain, 0.0, accepted)
        if accepted:
            return theta, damping, decrease
    return None, damping, 0.0


def uncertainty(here: Place, held_out: Equations, names: Sequence[str]) -> Uncertainty:
    """Return the covariance at a place, as wide as the held-out measurements ask for.

    Args:
        here: where the training ends.
        held_out: the held-out measurements to second order.
        names: of the groups of parameters.
    """
    inflation = max(here.chi_square, 1.0)
    spread = Uncertainty(here.factor, here.offset, inflation, {}).spread
    unexplained = held_out_scale(spread, held_out, here.chi_square)
    about = {
        "parameters": len(here.theta),
        "determined": here.determined,
        "chi_square": here.chi_square,
        "remaining": here.remaining,
        "held_out": unexplained,
        "strengths": dict(zip(names, here.prior.strengths.tolist(), strict=True)),
        "log_evidence": log_evidence(here.block.matrix, here.loss, here.degrees, here.theta, here.prior),
    }
    return Uncertainty(here.factor, here.offset, inflation * unexplained, about)


def held_out_scale(factor: Tensor, test: Equations, noise: float) -> float:
    """Return the factor on a covariance L L^T that held-out measurements ask for; 1 unless they refuse it.

    If theta is off by N(0, f L L^T), the squares of n residuals with noise of variance v add up to
    n v + f tr(A L L^T), with A = J^T J: their excess over n v gives f.

    Args:
        factor: L, shape (P, R).
        test: the held-out measurements to second order.
        noise: v, as the training found it.
    """
    if not test.blocks:
        return 1.0
    told = factor.mT @ test.blocks[0].matrix @ factor
    expected = float(told.diagonal().sum())
    variance = test.degrees * noise**2 + 2 * noise * expected + float(told.square().sum())
    excess = float(test.loss) - test.degrees * noise
    return excess / expected if excess > expected + REFUSED * (2 * variance) ** 0.5 else 1.0
