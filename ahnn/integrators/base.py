"""Base class of one-step integrators."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor

from ahnn.types import TimeStep, VectorField


class Integrator(ABC):
    """One-step method for autonomous fields."""

    name: str
    order: int

    @abstractmethod
    def increment(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (..., D).

        Losses compare increments, which retain digits that would be lost in a sum with a large state.

        Args:
            field: right-hand side of the differential equation.
            x: states, shape (..., D).
            dt: common step, or a (B,) tensor for states of shape (B, D).
        """

    def require(self, field: object) -> None:  # noqa: B027 - most methods accept any field
        """Check, before any computation, that the method can integrate a field.

        Raises:
            UserError: the field lacks the required structure.
        """

    def step(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt), shape (..., D); arguments as in `increment`."""
        return x + self.increment(field, x, dt)


def column(dt: TimeStep) -> TimeStep:
    """Return dt in a shape that multiplies states: a number unchanged, a (B,) tensor as (B, 1)."""
    return dt.unsqueeze(-1) if isinstance(dt, Tensor) and dt.ndim > 0 else dt
