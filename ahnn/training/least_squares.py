"""Least-squares problems in the parameters of a module: residuals and Jacobians of a batch.

Jacobians are in closed form for known structures, and otherwise by vectorised reverse mode, one pass per
residual of a sample. Recursive predictions propagate state sensitivities: W steps then cost W passes instead
of W^2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from ahnn.clock import on_clock
from ahnn.cores import each, slices
from ahnn.dynamics.derivatives import (
    increment_jacobian,
    mapped_jacobian,
    parametrised,
)
from ahnn.training.normal_equations import Equations, normal_equations
from ahnn.types import TimeStep, Window

SAMPLES = 1000
"""Number of samples whose residuals are computed at once, so that layers fit into a core's cache."""


class LeastSquaresProblem(Protocol):
    """Sum of squares as a function of the flat parameter vector theta, shape (P,)."""

    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals, a scalar."""
        ...

    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return the quadratic model at theta, which consists of tensors of the given sizes."""
        ...


class LeastSquares(NamedTuple):
    """Weighted residuals r(theta) of a batch, as functions of the flat parameter vector theta, shape (P,).

    Attributes:
        residuals: theta -> r, shape (N,).
        jacobian: theta -> dr/dtheta, shape (N, P), float32. It only determines the step direction; acceptance
            is decided by residuals in full precision.
    """

    residuals: Callable[[Tensor], Tensor]
    jacobian: Callable[[Tensor], Tensor]

    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals, a scalar."""
        return self.residuals(theta).square().sum()

    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations at theta."""
        residuals = self.residuals(theta)
        blocks = normal_equations(self.jacobian(theta).detach(), residuals, sizes)
        return Equations(residuals @ residuals, residuals.numel(), blocks)


def pointwise_problem(
    module: nn.Module,
    residuals: Callable[[Tensor], Tensor],
    x: Tensor,
    targets: Tensor,
    weights: Tensor,
    jacobian: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None,
) -> LeastSquares:
    """Return the problem of fitting a function of the state.

    Args:
        module: module whose parameters are the unknowns.
        residuals: the fitted function (B, D) -> (B, D), computed with the module.
        x: evaluation points, (B, D).
        targets: target values, (B, D).
        weights: residual weights, (B, D).
        jacobian: (theta, x, weights) -> (B, D, P) of weighted residuals, if available.
    """
    rows = jacobian or mapped_jacobian(module, residuals)

    def weighted(part: slice) -> Tensor:
        return (residuals(x[part]) - targets[part]) * weights[part]

    return LeastSquares(
        _all_residuals(module, weighted, x), lambda theta: rows(theta, x, weights).flatten(0, 1)
    )


def recursive_problem(
    module: nn.Module,
    increment: Callable[[Tensor, TimeStep], Tensor],
    batch: Window,
    weights: Tensor,
    clock: int = 0,
) -> LeastSquares:
    """Return the problem of predicting W steps recursively.

    Args:
        module: module whose parameters are the unknowns.
        increment: (x (B, D), dt) -> increment (B, D) of one step, computed with the module.
        batch: first states and true increments of W steps.
        weights: residual weights, (B, W, D).
        clock: number of clock coordinates of extended states, whose increments are known.
    """
    function = parametrised(module, increment, batch.start.dtype)
    derivatives = increment_jacobian(module, increment)

    def weighted(part: slice) -> Tensor:
        own, rows = batch.rows(part), []
        state, residual = own.start, torch.zeros_like(own.start)
        for k, target in enumerate(own.increments.unbind(1)):
            step = on_clock(increment(state, own.step(k)), target, clock)
            state, residual = state + step, residual + (step - target)
            rows.append(residual)
        return torch.stack(rows, dim=1) * weights[part]

    def jacobian(theta: Tensor) -> Tensor:
        state, factors = batch.start, weights.float().unsqueeze(-1)
        one = torch.eye(state.shape[-1], device=state.device)
        rows = torch.empty(*weights.shape, len(theta), device=state.device)
        sensitivity = torch.zeros(*state.shape, len(theta), device=state.device)
        for k in range(weights.shape[1]):
            of_theta, of_state = derivatives(theta, state, batch.step(k))
            with torch.no_grad():
                sensitivity = of_theta.baddbmm_(of_state + one, sensitivity)
                torch.mul(sensitivity, factors[:, k], out=rows[:, k])
                step = function(theta, state, batch.step(k))
                state = state + on_clock(step, batch.increments[:, k], clock)
        return rows.flatten(0, 2)

    return LeastSquares(_all_residuals(module, weighted, batch.start), jacobian)


def _all_residuals(
    module: nn.Module, part: Callable[[slice], Tensor], x: Tensor
) -> Callable[[Tensor], Tensor]:
    """Return theta -> r, (N,), from a function of selected samples, computed with the module.

    Args:
        module: module whose parameters are replaced by theta.
        part: selection of samples -> their residuals.
        x: states of all samples, (B, D).
    """
    parts = slices(len(x), SAMPLES, x.device)
    function = parametrised(module, lambda: torch.cat(each(part, parts, x.device)), x.dtype)
    return lambda theta: function(theta).flatten()
