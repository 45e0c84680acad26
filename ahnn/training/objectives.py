"""Training objectives, as residuals or as least-squares problems.

An objective is a value passed to a trainer. It needs only the dynamics and a batch, and is independent of
optimisers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import factorial
from typing import Any, Protocol, cast

import torch
from torch import Tensor, nn

from ahnn.clock import on_clock
from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.errors import UserError
from ahnn.extensions import Table
from ahnn.training.fitted_starts import FittedStarts
from ahnn.training.least_squares import (
    LeastSquares,
    LeastSquaresProblem,
    pointwise_problem,
    recursive_problem,
)
from ahnn.training.loss import Loss
from ahnn.types import Window

PARTS = 5
"""Inverse fraction of a batch used for a second-order step; the rest checks the step.

The check needs no Jacobian and can be large; a small check is noisy and raises the damping.
"""


class Objective(Protocol):
    """Training objective."""

    def residuals(self, dynamics: Dynamics, batch: Any) -> Tensor:
        """Return the weighted residuals of a batch, shape (B, ...)."""
        ...

    def problem(self, dynamics: Dynamics, batch: Any) -> LeastSquaresProblem:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        ...

    def divided(self, batch: Any) -> tuple[Any, Any | None]:
        """Split a batch into the part for a second-order step and the part that checks it, if any."""
        ...

    def validation(self, dynamics: Dynamics, batch: Any) -> dict[str, Tensor]:
        """Return the validation metrics of a batch: scalars, including `loss`."""
        ...


@dataclass(frozen=True, eq=False)
class Recursive:
    """Residuals x^_k - x_k of recursive predictions x^_k from x_0 over W steps (the paper's AHNN loss).

    Attributes:
        loss: residual units.
        window: number W of steps.
    """

    loss: Loss
    window: int

    def residuals(self, dynamics: Dynamics, batch: Window) -> Tensor:
        """Return the weighted residuals, shape (B, W, D).

        The residual is accumulated as a sum of differences of increments, which avoids cancellation in
        float32.
        """
        batch = batch.first(self.window)
        x = batch.start
        residual = torch.zeros_like(x)
        residuals = []
        for k, target in enumerate(batch.increments.unbind(1)):
            predicted = on_clock(dynamics.increment(x, batch.step(k)), target, dynamics.clock)
            x = x + predicted
            residual = residual + (predicted - target)
            residuals.append(residual)
        return torch.stack(residuals, dim=1) * self.loss.weights(batch.increments)

    def problem(self, dynamics: Dynamics, batch: Window) -> LeastSquares:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        batch = batch.first(self.window)
        weights = self.loss.weights(batch.increments)
        return recursive_problem(dynamics, dynamics.increment, batch, weights, dynamics.clock)

    def divided(self, batch: Window) -> tuple[Window, Window]:
        """Split off 1/(5 W) of the windows for the step, which gives as many residuals as for W = 1."""
        return divided(batch, PARTS * self.window)

    def validation(self, dynamics: Dynamics, batch: Window) -> dict[str, Tensor]:
        """Return the loss of W predictions, and `one_step`, the rms residual of single steps."""
        residuals = self.residuals(dynamics, batch)
        return {"loss": self.loss(residuals), "one_step": residuals[:, 0].square().mean().sqrt()}


@dataclass(frozen=True, eq=False)
class Derivative:
    """Comparison of the field with derivatives of the data, without a solver (Greydanus et al. 2019).

    Attributes:
        loss: residual units; residuals are multiplied by dt to become increments.
        order: order of the central differences.
    """

    loss: Loss
    order: int

    def residuals(self, dynamics: Dynamics, batch: Window) -> Tensor:
        """Return the weighted residuals, shape (B, D)."""
        middle, target = derivative_samples(batch.first(self.order))
        return (batch.dt * cast(HasField, dynamics).field(middle) - target) * self.loss.weights(target)

    def problem(self, dynamics: Dynamics, batch: Window) -> LeastSquares:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        middle, target = derivative_samples(batch.first(self.order))
        field, rows = cast(HasField, dynamics).field, field_jacobian(cast(HasField, dynamics))
        return pointwise_problem(
            dynamics,
            lambda x: batch.dt * field(x),
            middle,
            target,
            self.loss.weights(target),
            lambda theta, x, weights: _below_zeros(rows(theta, x, batch.dt * weights), x.shape[-1]),
        )

    def divided(self, batch: Window) -> tuple[Window, Window]:
        """Split off a fifth of the windows for the step; the rest checks it."""
        return divided(batch, PARTS)

    def validation(self, dynamics: Dynamics, batch: Window) -> dict[str, Tensor]:
        """Return the loss."""
        return {"loss": self.loss(self.residuals(dynamics, batch))}


def _below_zeros(rows: Tensor, size: int) -> Tensor:
    """Prepend zero rows for parameter-independent components to rows (B, L, P): (B, size, P)."""
    missing = size - rows.shape[1]
    return nn.functional.pad(rows, (0, 0, missing, 0)) if missing else rows  # `pad` always copies


OBJECTIVES: Table[Callable[..., Objective]] = Table(
    "ahnn.objectives", {"recursive": Recursive, "fitted_starts": FittedStarts}
)
"""Objectives by their `loss.objective` name: called with the loss, the window W and `loss.options`."""


def divided(batch: Window, parts: int) -> tuple[Window, Window]:
    """Split off a fraction of a batch, at least one window, and return it with the rest."""
    split = max(1, len(batch.start) // parts)
    return batch.rows(slice(None, split)), batch.rows(slice(split, None))


def derivative_samples(window: Window) -> tuple[Tensor, Tensor]:
    """Return the middle sample of each window of W = 2m steps, and dt times its derivative, (B, D).

    The derivative is the central difference of order W. A field fitted to it has no integrator error.

    Args:
        window: start (B, D) and true increments (B, W, D), with even W and equal steps.

    Raises:
        UserError: unequal steps.
    """
    if isinstance(window.dt, Tensor):
        message = (
            "loss: expected samples at equal steps for derivatives of the data; received unequal steps. "
            "Set loss.derivative=0, or data.noise if they are measurements"
        )
        raise UserError(message)
    steps = window.increments.shape[1]
    middle = window.start + window.increments[:, : steps // 2].sum(1)
    return middle, torch.einsum("w,bwd->bd", difference_weights(steps).to(middle), window.increments)


@cache
def difference_weights(steps: int) -> Tensor:
    """Return the weights of W = 2m increments in dt dx/dt at the middle sample, shape (W,), float64.

    The central difference of order 2m is sum_j w_j (x_{m+j} - x_{m-j}) / dt with
    w_j = (-1)^(j+1) m!^2 / (j (m-j)! (m+j)!) (Fornberg 1988, Math. Comp. 51, 699-706); an increment
    contributes to every difference that spans it.
    """
    m = steps // 2
    divisors = [j * factorial(m - j) * factorial(m + j) for j in range(1, m + 1)]
    w = [(-1) ** j * factorial(m) ** 2 / divisor for j, divisor in enumerate(divisors)]
    spans = [sum(w[max(m - k, k - m + 1) - 1 :]) for k in range(steps)]
    return torch.tensor(spans, dtype=torch.float64)
