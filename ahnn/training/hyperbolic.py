"""Hyperbolic learning-rate schedules, insensitive to the number of epochs (Kim 2024, arXiv 2407.15200)."""

from __future__ import annotations

import math
from typing import Any

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from ahnn.arguments import Count, Finite, Positive, checked
from ahnn.errors import UserError


@checked
class ExpHyperbolicLR(LRScheduler):
    """eta(n) = eta_0 (eta_0 / eta_inf)^(h(n) - h(0)), h(n) = sqrt((N - n)/U (2 - (N + n)/U)).

    The initial slope depends on U and hardly on N, so settings found in short runs apply to long runs.
    The infimum is reached only for U = N.

    Args:
        optimizer: optimiser with initial learning rates eta_0.
        max_epochs: number N of training epochs; later epochs keep the last rate.
        upper_bound: U >= N.
        infimum_lr: eta_inf < eta_0.

    Raises:
        UserError: U < N, or an infimum that is not below the initial rate.
    """

    def __init__(
        self, optimizer: Optimizer, *, max_epochs: Count, upper_bound: Finite, infimum_lr: Positive
    ) -> None:
        initial = [float(group["lr"]) for group in optimizer.param_groups]
        if upper_bound < max_epochs or infimum_lr >= min(initial):
            message = (
                f"scheduler: expected upper_bound >= max_epochs and infimum_lr < optimizer.lr; received "
                f"{upper_bound=}, {max_epochs=}, {infimum_lr=}, optimizer.lr={min(initial)}"
            )
            raise UserError(message)
        self.max_epochs, self.upper_bound, self.infimum_lr = max_epochs, upper_bound, infimum_lr
        super().__init__(optimizer)

    def get_lr(self) -> list[float | Any]:
        """Return the rate of each parameter group in the current epoch."""
        exponent = self._height(min(self.last_epoch, self.max_epochs)) - self._height(0)
        return [rate * (rate / self.infimum_lr) ** exponent for rate in self.base_lrs]

    def _height(self, n: int) -> float:
        big_n, u = self.max_epochs, self.upper_bound
        return math.sqrt((big_n - n) / u * (2 - (big_n + n) / u))
