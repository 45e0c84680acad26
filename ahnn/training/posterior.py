"""The last steps of a training on measurements: all of them at once, with a prior on the parameters."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.shooting.starts import FOLLOWING, SURE, refine
from ahnn.training.evidence import Prior
from ahnn.training.normal_equations import Block
from ahnn.training.shooting import Limit, ShootingProblem, freedom


class WideProblem(ShootingProblem):
    """Segments whose normal equations are summed in float64: badly known directions keep their digits."""

    precision = torch.float64

    @torch.no_grad()
    def follow(self, theta: Tensor) -> None:
        """Move the starts to where they fit best after a step to theta, shape (P,)."""
        near = self.refitted(theta).starts
        fitted = refine(self.trial(theta), near, self.batch, self.steps, FOLLOWING, SURE)
        self._linear = None
        self.starts, self.limit = fitted.starts, Limit.of(fitted.sums, freedom(self.batch))


def with_prior(block: Block, prior: Prior, theta: Tensor) -> Block:
    """Return the normal equations of residuals and prior at theta, shape (P,)."""
    precision = prior.precision
    matrix = block.matrix + torch.diag(precision)
    return block._replace(matrix=matrix, gradient=block.gradient + precision * theta)
