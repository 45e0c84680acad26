"""An objective: where predictions end, and not the way that they take."""

from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor

from ahnn.arguments import Count
from ahnn.dynamics import Dynamics
from ahnn.training import LeastSquares, Loss, Recursive, recursive_problem
from ahnn.training.objectives import PARTS, divided
from ahnn.types import Window


@final
@dataclass(frozen=True, eq=False)
class Endpoint:
    """The last states of W recursive predictions; `last` is an option in YAML."""

    loss: Loss
    window: int
    last: Count = 1

    def residuals(self, dynamics: Dynamics, batch: Window) -> Tensor:
        """Return the weighted residuals of the last states, shape (B, last, D)."""
        return Recursive(self.loss, self.window).residuals(dynamics, batch)[:, -self.last :]

    def problem(self, dynamics: Dynamics, batch: Window) -> LeastSquares:
        """Return the same for second-order steps: weight 0 for the states on the way."""
        batch = batch.first(self.window)
        weights = self.loss.weights(batch.increments)
        counts = torch.arange(self.window) >= self.window - self.last
        return recursive_problem(dynamics, dynamics.increment, batch, weights * counts[:, None])

    def divided(self, batch: Window) -> tuple[Window, Window]:
        """Return the part of a batch that makes a second-order step, and the part that checks it."""
        return divided(batch, PARTS * self.window)

    def validation(self, dynamics: Dynamics, batch: Window) -> dict[str, Tensor]:
        """Return what a validation logs."""
        return {"loss": self.loss(self.residuals(dynamics, batch))}
