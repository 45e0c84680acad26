"""A batch as a least-squares problem in the parameters of a module: residuals and their Jacobian.

Jacobians come from vectorised reverse mode, one pass per residual of a sample. Recursive predictions carry
the sensitivity of their state along instead: W steps then cost W passes and not W^2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torch.func import jacrev, vmap

from ahnn.dynamics.derivatives import parametrised
from ahnn.training.normal_equations import Equations, normal_equations
from ahnn.types import TimeStep, Window


class Problem(Protocol):
    """A sum of squares in the flat parameter vector theta, shape (P,)."""

    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals, a scalar."""
        ...

    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return the problem to second order at theta, which consists of tensors of these sizes."""
        ...


class LeastSquares(NamedTuple):
    """Weighted residuals r(theta) of a batch, as functions of the flat parameter vector theta, shape (P,).

    Attributes:
        residuals: theta -> r, shape (N,).
        jacobian: theta -> dr/dtheta, shape (N, P), float32. It only shapes the step; whether the step is
            good is decided by residuals in full precision.
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
    module: nn.Module, residuals: Callable[[Tensor], Tensor], x: Tensor, targets: Tensor, weights: Tensor
) -> LeastSquares:
    """Return the problem of fitting a function of single states.

    Args:
        module: its parameters are the unknowns.
        residuals: the fitted function (B, D) -> (B, D), computed with the module.
        x: where it is compared, (B, D).
        targets: what it is compared with, (B, D).
        weights: of the residuals, (B, D).
    """
    function = parametrised(module, residuals, x.dtype)
    single = parametrised(module, residuals, torch.float32)

    def of_sample(theta: Tensor, sample: Tensor) -> Tensor:
        return single(theta, sample.unsqueeze(0)).squeeze(0)

    def weighted(theta: Tensor) -> Tensor:
        return ((function(theta, x) - targets) * weights).flatten()

    def jacobian(theta: Tensor) -> Tensor:
        rows = vmap(jacrev(of_sample), (None, 0))(theta.float(), x.float())
        return (rows * weights.float().unsqueeze(-1)).flatten(0, -2)

    return LeastSquares(torch.no_grad()(weighted), jacobian)


def recursive_problem(
    module: nn.Module, increment: Callable[[Tensor, TimeStep], Tensor], batch: Window, weights: Tensor
) -> LeastSquares:
    """Return the problem of predicting W steps recursively.

    Args:
        module: its parameters are the unknowns.
        increment: (x (B, D), dt) -> (B, D) of one step, computed with the module.
        batch: first states and true increments of W steps.
        weights: of the residuals, (B, W, D).
    """
    function = parametrised(module, increment, batch.start.dtype)
    single = parametrised(module, increment, torch.float32)
    own_steps = isinstance(batch.dt, Tensor)

    def of_sample(theta: Tensor, sample: Tensor, dt: TimeStep) -> Tensor:
        step = dt.unsqueeze(0) if isinstance(dt, Tensor) else dt
        return single(theta, sample.unsqueeze(0), step).squeeze(0)

    def weighted(theta: Tensor) -> Tensor:
        state, residual, rows = batch.start, torch.zeros_like(batch.start), []
        for k, target in enumerate(batch.increments.unbind(1)):
            step = function(theta, state, batch.step(k))
            state, residual = state + step, residual + (step - target)
            rows.append(residual)
        return (torch.stack(rows, dim=1) * weights).flatten()

    def jacobian(theta: Tensor) -> Tensor:
        derivatives = vmap(jacrev(of_sample, argnums=(0, 1)), (None, 0, 0 if own_steps else None))
        state, rows = batch.start, []
        sensitivity = torch.zeros(*state.shape, len(theta), device=state.device)
        for k in range(batch.increments.shape[1]):
            dt = batch.step(k)
            of_theta, of_state = derivatives(
                theta.float(), state.float(), dt.float() if isinstance(dt, Tensor) else dt
            )
            with torch.no_grad():
                sensitivity = sensitivity + of_theta + of_state @ sensitivity
                rows.append(sensitivity * weights[:, k, :, None].float())
                state = state + function(theta, state, dt)
        return torch.stack(rows, dim=1).flatten(0, 2)

    return LeastSquares(torch.no_grad()(weighted), jacobian)
