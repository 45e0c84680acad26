"""Residuals of a dynamics model on a window of data, and the loss made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional as F

from ahnn.errors import UserError
from ahnn.types import TimeStep, VectorField, Window

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
    """

    kind: Literal["recursive", "derivative"] = "recursive"
    scale: Literal["increment", "state"] = "increment"
    delta: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what no loss can be made of."""
        if (
            self.kind not in ("recursive", "derivative")
            or self.scale not in ("increment", "state")
            or not self.delta > 0
        ):
            message = (
                "loss: expected kind recursive or derivative, scale increment or state, and delta > 0; "
                f"received kind={self.kind!r}, scale={self.scale!r}, delta={self.delta!r}"
            )
            raise UserError(message)

    def __call__(self, residuals: Tensor) -> Tensor:
        """Return the mean Huber loss of scaled residuals, a scalar."""
        return F.huber_loss(residuals, torch.zeros_like(residuals), delta=self.delta)


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


def derivative_residuals(field: VectorField, window: Window) -> Tensor:
    """Return dt times field minus increment, shape (B, W, D), the field taken half-way between samples.

    The difference quotient of consecutive samples is the derivative there to second order, which is all that
    sampled data offer without knowledge of the system.

    Args:
        field: x -> dx/dt of the model.
        window: start (B, D) and true increments (B, W, D).
    """
    ends = window.start.unsqueeze(1) + window.increments.cumsum(1)
    middles = ends - window.increments / 2
    return window.dt * field(middles) - window.increments
