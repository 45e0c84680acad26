"""Residuals of a dynamics model on a window of data, and the loss made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional as F

from ahnn.errors import UserError
from ahnn.types import TimeStep, VectorField, Window

FLOOR = 0.03
"""Local increments below this share of the typical one are not weighted up any further."""

Increment = Callable[[Tensor, TimeStep], Tensor]


@dataclass(frozen=True)
class Loss:
    """What training minimises.

    Attributes:
        kind: `recursive` compares W recursive predictions with the data (the paper); `derivative` compares
            the field with difference quotients (Greydanus et al. 2019).
        scale: unit of residuals, `increment` (rms increment of each component) or `state` (half range of
            each component, the paper). One-step residuals are tiny beside the state, and their gradients
            fall below Adam's epsilon; in units of the increment they do not.
        delta: residual, in those units, at which Huber's loss turns from quadratic to linear.
        balance: weight of relative errors. 0 measures a residual in the same unit everywhere; 1 in units of
            the local increment of its block, so that slow parts of a trajectory count as much as fast ones.
    """

    kind: Literal["recursive", "derivative"] = "recursive"
    scale: Literal["increment", "state"] = "increment"
    delta: float = 1.0
    balance: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no loss can be made of."""
        if (
            self.kind not in ("recursive", "derivative")
            or self.scale not in ("increment", "state")
            or not self.delta > 0
        ):
            message = (
                "loss: expected kind recursive or derivative, scale increment or state, delta > 0 and "
                f"0 <= balance <= 1; received {asdict(self)}"
            )
            raise UserError(message)

    def __call__(self, residuals: Tensor) -> Tensor:
        """Return the mean Huber loss of scaled residuals, a scalar."""
        return F.huber_loss(residuals, torch.zeros_like(residuals), delta=self.delta)

    def scaled(self, residuals: Tensor, targets: Tensor, scale: Tensor) -> Tensor:
        """Return residuals in units of the loss, shape (B, W, D).

        Args:
            residuals: (B, W, D), in physical units.
            targets: (B, W, D) increments that the residuals belong to.
            scale: (D,) typical size of a residual's component.
        """
        residuals = residuals / scale
        if self.balance == 0:
            return residuals
        blocks = (targets / scale).unflatten(-1, (2, -1))
        local = blocks.square().mean(-1, keepdim=True) + FLOOR**2
        return (residuals.unflatten(-1, (2, -1)) * local ** (-self.balance / 2)).flatten(-2)


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


def derivative_residuals(field: VectorField, window: Window) -> tuple[Tensor, Tensor]:
    """Return dt (field - derivative of the data) in the middle of the window, and dt times that derivative.

    State and derivative in the middle are those of the polynomial through all W + 1 samples, so the window
    sets the order: one step gives the difference quotient, an even W the central difference of order W. What
    is learned this way is the field itself, free of the integrator's error.

    Args:
        field: x -> dx/dt of the model.
        window: start (B, D) and true increments (B, W, D).

    Returns:
        residuals and targets, each (B, 1, D).
    """
    state, slope = (w.to(window.start) for w in middle_weights(window.increments.shape[1]))
    middle = window.start + torch.einsum("w,bwd->bd", state, window.increments)
    target = torch.einsum("w,bwd->bd", slope, window.increments)
    return (window.dt * field(middle) - target).unsqueeze(1), target.unsqueeze(1)


@cache
def middle_weights(steps: int) -> tuple[Tensor, Tensor]:
    """Return the weights of W increments in x(W/2) - x(0) and in dx/dt(W/2) dt, each (W,) float64.

    Those of Lagrange's polynomial through the samples 0..W, summed from the end because a sample is the start
    plus all increments before it.
    """
    nodes = torch.arange(steps + 1, dtype=torch.float64) - steps / 2
    powers = torch.linalg.inv(torch.vander(nodes / max(steps / 2, 1), increasing=True))
    value, slope = powers[0], powers[1] / max(steps / 2, 1)
    tails = [w.flip(0).cumsum(0).flip(0)[1:] for w in (value, slope)]
    return tails[0], tails[1]
