"""Symplectic compositions for separable Hamiltonians: one drift-kick loop over the weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.integrators.base import Integrator, column
from ahnn.types import SeparableField, TimeStep, VectorField


@dataclass(frozen=True)
class SymmetricComposition(Integrator):
    """Composition of drift-kick-drift leapfrogs with palindromic weights.

    Adjacent half drifts are merged, so a step of s stages evaluates s forces and s + 1 velocities
    (Hairer, Lubich & Wanner, Geometric Numerical Integration, section V.3).

    Attributes:
        half: the weights gamma_1 .. gamma_centre.
    """

    name: str
    order: int
    half: tuple[float, ...]

    @cached_property
    def weights(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Weights of the drifts, (s + 1), and of the kicks, (s)."""
        kicks = self.half + self.half[-2::-1]
        padded = (0.0, *kicks, 0.0)
        drifts = tuple((left + right) / 2 for left, right in pairwise(padded))
        return drifts, kicks

    def require(self, field: object) -> None:
        """Raise UserError for a field that is not separable, or whose attribute `separable` is False."""
        if not (isinstance(field, SeparableField) and getattr(field, "separable", True)):
            message = (
                f"integrator {self.name}: expected a separable Hamiltonian T(p) + V(q), whose field offers "
                f"velocity(p) and force(q); received {type(field).__name__}. Use rk4 or gl4 for this field."
            )
            raise UserError(message)

    def increment(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the increment of one composed step, shape (..., D).

        Raises:
            UserError: the field is not separable.
        """
        self.require(field)
        assert isinstance(field, SeparableField)
        h = column(dt)
        drifts, kicks = self.weights
        q, p = x.chunk(2, dim=-1)
        dq = field.velocity(p) * (drifts[0] * h)
        dp = torch.zeros_like(p)
        for kick, drift in zip(kicks, drifts[1:], strict=True):
            dp = dp + field.force(q + dq) * (kick * h)
            dq = dq + field.velocity(p + dp) * (drift * h)
        return torch.cat((dq, dp), dim=-1)
