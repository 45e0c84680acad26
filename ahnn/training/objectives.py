"""What training minimises: recursive prediction errors, derivative errors, and the weights of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from math import factorial
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional as F

from ahnn.errors import UserError
from ahnn.types import TimeStep, Window

FLOOR = 0.03
"""Local increments below this share of the typical one are not weighted up any further."""

Increment = Callable[[Tensor, TimeStep], Tensor]


@dataclass(frozen=True)
class Loss:
    """The training objective.

    Attributes:
        scale: unit of residuals, `increment` (rms increment of each component) or `state` (half range of
            each component, the paper). One-step residuals are tiny beside the state, and their gradients
            fall below Adam's epsilon; in units of the increment they do not.
        delta: residual, in those units, at which Huber's loss turns from quadratic to linear.
        balance: weight of relative errors. 0 measures a residual in the same unit everywhere; 1 in units of
            the local increment of its block, so that slow parts of a trajectory count as much as fast ones.
        derivative: share of the epochs, from the first, that fits the field to derivatives of the data; the
            rest fits recursive predictions (the paper). 1 is the loss of Greydanus et al. 2019.
        order: of the central differences that give those derivatives; even.
    """

    scale: Literal["increment", "state"] = "increment"
    delta: float = 1.0
    balance: float = 0.0
    derivative: float = 0.0
    order: int = 12

    def __post_init__(self) -> None:
        """Refuse what no loss can be made of."""
        possible = self.delta > 0 and 0 <= self.balance <= 1 and 0 <= self.derivative <= 1
        if not possible or self.order < 2 or self.order % 2 or self.scale not in ("increment", "state"):
            message = (
                "loss: expected scale increment or state, delta > 0, balance and derivative in [0, 1], "
                f"and an even order >= 2; received {asdict(self)}"
            )
            raise UserError(message)

    def __call__(self, residuals: Tensor) -> Tensor:
        """Return the mean Huber loss of weighted residuals, a scalar."""
        return F.huber_loss(residuals, torch.zeros_like(residuals), delta=self.delta)

    def weights(self, targets: Tensor, scale: Tensor) -> Tensor:
        """Return the factors that bring residuals into the units of the loss, shape (..., D).

        Args:
            targets: (..., D) increments that the residuals belong to.
            scale: (D,) typical size of a residual's component.
        """
        if self.balance == 0:
            return (1 / scale).expand_as(targets)
        blocks = (targets / scale).unflatten(-1, (2, -1))
        local = blocks.square().mean(-1, keepdim=True) + FLOOR**2
        return (local ** (-self.balance / 2)).expand_as(blocks).flatten(-2) / scale


def recursive_residuals(increment: Increment, window: Window) -> Tensor:
    """Return x^_k - x_k, shape (B, W, D), with x^_k predicted recursively from x_0 (the paper's AHNN loss).

    The residual is carried as a sum of differences of increments, which keeps its digits in float32.

    Args:
        increment: (x, dt) -> x(t + dt) - x(t) of the model.
        window: start (B, D) and true increments (B, W, D).
    """
    x = window.start
    residual = torch.zeros_like(x)
    residuals = []
    for target in window.increments.unbind(1):
        predicted = increment(x, window.dt)
        x = x + predicted
        residual = residual + (predicted - target)
        residuals.append(residual)
    return torch.stack(residuals, dim=1)


def derivative_samples(window: Window) -> tuple[Tensor, Tensor]:
    """Return the sample in the middle of each window of W = 2m steps, and dt times its derivative, (B, D).

    The derivative is the central difference of order W. A field that is fitted to it is the field itself,
    free of an integrator's error.

    Args:
        window: start (B, D) and true increments (B, W, D), W even.
    """
    steps = window.increments.shape[1]
    middle = window.start + window.increments[:, : steps // 2].sum(1)
    return middle, torch.einsum("w,bwd->bd", difference_weights(steps).to(middle), window.increments)


@cache
def difference_weights(steps: int) -> Tensor:
    """Return the weights of W = 2m increments in dt dx/dt at the middle sample, shape (W,), float64.

    The central difference of order 2m is sum_j w_j (x_{m+j} - x_{m-j}) / dt with
    w_j = (-1)^(j+1) m!^2 / (j (m-j)! (m+j)!) (Fornberg 1988, Math. Comp. 51, 699-706); an increment takes
    part in every difference that spans it.
    """
    m = steps // 2
    divisors = [j * factorial(m - j) * factorial(m + j) for j in range(1, m + 1)]
    w = [(-1) ** j * factorial(m) ** 2 / divisor for j, divisor in enumerate(divisors)]
    spans = [sum(w[max(m - k, k - m + 1) - 1 :]) for k in range(steps)]
    return torch.tensor(spans, dtype=torch.float64)
