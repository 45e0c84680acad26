"""Springs of known stiffness."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from ahnn.arguments import Finite, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.errors import UserError


@final
@checked
class Spring(Force):
    """Force -K q of known springs.

    Args:
        dof: degrees of freedom n.
        controls: not used.
        stiffness: common stiffness, or the symmetric matrix K, n rows of n numbers.

    Raises:
        UserError: a matrix that is not symmetric or has the wrong shape.
    """

    assumes = "known springs"

    def __init__(self, dof: int, controls: int = 0, *, stiffness: Finite | list[list[Finite]]) -> None:
        super().__init__()
        diagonal = not isinstance(stiffness, list)
        rows = [[stiffness * (i == j) for j in range(dof)] for i in range(dof)] if diagonal else stiffness
        if [len(row) for row in rows] != [dof] * dof or rows != [list(c) for c in zip(*rows, strict=True)]:
            message = f"spring: expected a symmetric matrix, {dof} by {dof}; received {stiffness}"
            raise UserError(message)
        self.stiffness = rows

    def forward(self, at: Instant) -> Tensor:
        """Return -K q, shape (..., n)."""
        return -at.q @ torch.tensor(self.stiffness, dtype=torch.float64).to(at.q)

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation -K dq, shape (B, R, n)."""
        return self(by)

    def potential(self, at: Instant) -> Tensor:
        """Return q^T K q / 2, shape (...)."""
        return -0.5 * (self(at) * at.q).sum(-1)
