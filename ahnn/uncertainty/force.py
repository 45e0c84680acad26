"""How uncertain a learned force is at a state, as the covariance of the parameters has it."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import HasField
from ahnn.dynamics.derivatives import field_jacobian

KEPT = 0.9999
"""Share of the variance at the given states that the directions of parameters have that are kept."""
LEAST = 1e-6
"""Force, over its root mean square at the given states, of which a fraction is not counted any more."""


@torch.no_grad()
def force_deviation(dynamics: nn.Module, spread: Tensor, states: Tensor) -> Callable[[Tensor], Tensor]:
    """Return x (..., D) -> standard deviation of the learned dp/dt as a fraction of its size, shape (...).

    To first order in the parameters, the root mean square over the components. Of all directions in which
    parameters are uncertain few move the force: the others are left out.

    Args:
        dynamics: with a field, float64; their parameters are theta.
        spread: L, shape (P, R); L L^T is the covariance of theta.
        states: (M, D) that stand for those that will be asked for.
    """
    field, dof = cast(HasField, dynamics).field, states.shape[-1] // 2
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing = field_jacobian(cast(HasField, dynamics))

    def size(x: Tensor) -> Tensor:
        return field(x)[..., dof:].norm(dim=-1)

    least = LEAST * size(states).square().mean().sqrt()

    def fractions(x: Tensor, directions: Tensor) -> Tensor:
        moved = forcing(theta, x)[..., -dof:, :] @ directions
        return moved / size(x).clamp(min=least)[..., None, None].to(moved)

    directions = spread.float() @ _axes(fractions(states, spread.float()).flatten(0, 1))

    @torch.no_grad()
    def deviation(x: Tensor) -> Tensor:
        return fractions(x, directions).square().sum((-2, -1)).div(dof).sqrt().to(x)

    return deviation


def _axes(rows: Tensor) -> Tensor:
    """Return the directions (R, K) that hold nearly all of the squares of rows (N, R)."""
    _, sizes, axes = torch.linalg.svd(rows, full_matrices=False)
    shares = sizes.square().cumsum(0) / sizes.square().sum()
    return axes[: int((shares < KEPT).sum()) + 1].mT
