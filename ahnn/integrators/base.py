"""What every one-step method offers: an increment, and the step made of it."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor

from ahnn.types import TimeStep, VectorField


class Integrator(ABC):
    """A one-step method for autonomous fields."""

    name: str
    order: int

    @abstractmethod
    def increment(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (..., D).

        Losses compare increments because they keep the digits that a sum with a large state loses.

        Args:
            field: right-hand side of the differential equation.
            x: states, shape (..., D).
            dt: one step for all, or a (B,) tensor for states of shape (B, D).
        """

    def require(self, field: object) -> None:  # noqa: B027 - most methods take any field
        """Refuse a field that the method cannot integrate, before anything is computed.

        Raises:
            UserError: it lacks the structure that the method needs.
        """

    def step(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt), shape (..., D); arguments as in `increment`."""
        return x + self.increment(field, x, dt)


def column(dt: TimeStep) -> TimeStep:
    """Return dt so that it multiplies states: a number as it is, a (B,) tensor as (B, 1)."""
    return dt.unsqueeze(-1) if isinstance(dt, Tensor) and dt.ndim > 0 else dt
