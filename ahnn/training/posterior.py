"""The last steps of a training on measurements: all of them at once, with a prior on the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.robust import ROBUST
from ahnn.shooting.starts import refine
from ahnn.training.evidence import Prior, by_evidence
from ahnn.training.normal_equations import Block, Equations, Rows
from ahnn.training.shooting import REFITS, Limit, Shooting, ShootingProblem, freedom


class WideProblem(ShootingProblem):
    """Segments whose normal equations are summed in float64: badly known directions keep their digits."""

    def _projected(self, theta: Tensor, part: slice) -> Rows:
        rows = super()._projected(theta, part)
        return rows._replace(jacobian=rows.jacobian.to(theta))

    @torch.no_grad()
    def follow(self, theta: Tensor) -> None:
        """Move the starts to where they fit best after a step to theta, shape (P,)."""
        fitted = refine(self._at(theta), self.starts, self.batch, self.steps, REFITS)
        self.starts, self.limit = fitted.starts, Limit.of(fitted.sums, freedom(self.batch))


def with_prior(block: Block, prior: Prior, theta: Tensor) -> Block:
    """Return the normal equations of residuals and prior at theta, shape (P,)."""
    precision = prior.precision
    matrix = block.matrix + torch.diag(precision)
    return block._replace(matrix=matrix, gradient=block.gradient + precision * theta)


class PosteriorProblem(WideProblem):
    """Segments together with a prior whose strengths are those of the largest evidence at each step.

    Attributes:
        prior: of the last equations; None before the first ones, when there is nothing to choose it by.
    """

    prior: Prior | None = None

    @torch.no_grad()
    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals, and what the prior adds to it."""
        squares = super().loss(theta)
        return squares if self.prior is None else squares + self.prior.penalty(theta)

    @torch.no_grad()
    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations, the prior among them."""
        loss, degrees, blocks = super().equations(theta, sizes)
        if not blocks:
            return Equations(loss, degrees, blocks)
        (block,) = blocks
        self.prior = by_evidence(block.matrix, theta, sizes)
        return Equations(loss + self.prior.penalty(theta), degrees, [with_prior(block, self.prior, theta)])


@dataclass(frozen=True, eq=False)
class Posterior(Shooting):
    """Shooting over all whole trajectories in each step, with a prior chosen by evidence."""

    intervals: int | None = None
    all_at_once: bool = True

    def problem(self, dynamics: Dynamics, batch: Segment) -> PosteriorProblem:
        """Return residuals and prior as a problem in the parameters of the dynamics."""
        return PosteriorProblem(dynamics, batch, ROBUST[self.robust])
