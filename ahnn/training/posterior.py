"""The last steps of a training on measurements: all of them at once, with a prior on the parameters."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.measurements import Segment
from ahnn.shooting.paths import Steps
from ahnn.shooting.starts import SURE, Fitted, Trial, refine
from ahnn.training.evidence import Prior
from ahnn.training.normal_equations import Block
from ahnn.training.shooting import Limit, ShootingProblem, freedom

FOLLOWING = 4
"""Steps of the starts after one of the parameters, at most."""


class WideProblem(ShootingProblem):
    """Segments whose normal equations are summed in float64: badly known directions keep their digits."""

    precision = torch.float64

    def fit_again(self, trial: Trial, starts: Tensor, segment: Segment, steps: Steps) -> Fitted:
        """Return the fit with derivatives of its own at each step: last steps are long."""
        return refine(trial, starts, segment, steps, FOLLOWING, SURE)

    @torch.no_grad()
    def follow(self, theta: Tensor) -> None:
        """Move the starts to where they fit best after a step to theta, shape (P,)."""
        fitted = self.refitted(theta)
        self._linear = None
        self.starts, self.limit = fitted.starts, Limit.of(fitted.sums, freedom(self.batch))


def with_prior(block: Block, prior: Prior, theta: Tensor) -> Block:
    """Return the normal equations of residuals and prior at theta, shape (P,)."""
    precision = prior.precision
    matrix = block.matrix + torch.diag(precision)
    return block._replace(matrix=matrix, gradient=block.gradient + precision * theta)
