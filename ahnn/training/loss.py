"""Residual units and Huber loss."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ahnn.arguments import Positive, Within, checked
from ahnn.statistics import Statistics

FLOOR = 0.03
"""Fraction of the typical increment below which local increments receive no further weight."""


@checked
@dataclass(frozen=True)
class LossOptions:
    """Training objective and its schedule.

    Attributes:
        scale: unit of residuals, `increment` (rms increment of each component) or `state` (half range of
            each component, the paper). One-step residuals in units of the state are so small that gradients
            fall below Adam's epsilon; in units of the increment they do not.
        delta: residual, in these units, at which the Huber loss changes from quadratic to linear.
        balance: weight of relative errors. 0 for a constant unit; 1 for units of the local increment of
            positions or momenta, so that slow parts of a trajectory have the same weight as fast ones.
        derivative: initial fraction of the epochs in which the field is fitted to derivatives of the data;
            the remaining epochs fit recursive predictions (the paper). 1 gives the loss of Greydanus et al.
            2019.
        order: even order of the central differences for these derivatives.
        objective: objective after the derivatives: recursive predictions or one of an installed package.
        options: options of the objective.
    """

    scale: Literal["increment", "state"] = "increment"
    delta: Positive = 1.0
    balance: Annotated[float, Within(0, 1)] = 0.0
    derivative: Annotated[float, Within(0, 1)] = 0.0
    order: Annotated[int, Within(2, multiple=2)] = 12
    objective: str = "recursive"
    options: dict[str, Any] = field(default_factory=dict)


class Loss(nn.Module):
    """Mean Huber loss of residuals in units fitted to the training split.

    Args:
        size: number D of state components; clock coordinates have unit 1.
        options: scale, delta and balance.
    """

    unit: Tensor

    def __init__(self, size: int, options: LossOptions) -> None:
        super().__init__()
        self.options = options
        self.register_buffer("unit", torch.ones(size))

    @torch.no_grad()
    def fit(self, statistics: Statistics) -> None:
        """Set the unit of each component."""
        half_range = (statistics.maximum - statistics.minimum) / 2
        sizes = statistics.increment if self.options.scale == "increment" else half_range
        self.unit.unflatten(0, (2, -1))[:, : len(sizes) // 2] = sizes.unflatten(0, (2, -1))

    def forward(self, residuals: Tensor) -> Tensor:
        """Return the mean Huber loss of weighted residuals, a scalar."""
        return F.huber_loss(residuals, torch.zeros_like(residuals), delta=self.options.delta)

    def weights(self, targets: Tensor) -> Tensor:
        """Return the factors that convert residuals to the units of the loss, shape (..., D).

        Args:
            targets: (..., D) true increments of the residuals.
        """
        if self.options.balance == 0:
            return (1 / self.unit).expand_as(targets)
        blocks = (targets / self.unit).unflatten(-1, (2, -1))
        local = blocks.square().mean(-1, keepdim=True) + FLOOR**2
        return (local ** (-self.options.balance / 2)).expand_as(blocks).flatten(-2) / self.unit
