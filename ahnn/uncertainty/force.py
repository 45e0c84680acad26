"""Uncertainty of a learned force from the parameter covariance."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import HasField
from ahnn.dynamics.derivatives import field_jacobian

KEPT = 0.9999
"""Fraction of the variance at the given states explained by the retained parameter directions."""
LEAST = 1e-6
"""Regularisation of the relative deviation for small forces, relative to the rms at the given states."""


@torch.no_grad()
def force_deviation(dynamics: nn.Module, spread: Tensor, states: Tensor) -> Callable[[Tensor], Tensor]:
    """Return x (..., D) -> standard deviation of the learned dp/dt as a fraction of its size, shape (...).

    It is computed to first order in the parameters, as the root mean square over components. Only the few
    parameter directions that affect the force are kept.

    Args:
        dynamics: float64 dynamics with a field and parameters theta.
        spread: L, shape (P, R); L L^T is the covariance of theta.
        states: (M, D) representative states.
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
    """Return the principal directions (R, K) of rows (N, R)."""
    _, sizes, axes = torch.linalg.svd(rows, full_matrices=False)
    fractions = sizes.square().cumsum(0) / sizes.square().sum()
    return axes[: int((fractions < KEPT).sum()) + 1].mT
