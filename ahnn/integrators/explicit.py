"""Explicit Runge-Kutta methods: one loop over a Butcher tableau."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ahnn.integrators.base import Integrator, column
from ahnn.integrators.tableaus import ButcherTableau
from ahnn.types import TimeStep, VectorField


@dataclass(frozen=True)
class ExplicitRungeKutta(Integrator):
    """Explicit Runge-Kutta method of a tableau, with a fixed step."""

    name: str
    order: int
    tableau: ButcherTableau

    def increment(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the increment dt * sum_i b_i k_i, shape (..., D)."""
        h = column(dt)
        slopes = [field(x)]
        for row in self.tableau.a:
            slopes.append(field(x + h * _combine(row, slopes)))
        return h * _combine(self.tableau.b, slopes)


def _combine(weights: tuple[float, ...], slopes: list[Tensor]) -> Tensor:
    """Return sum_i weights_i slopes_i skipping slopes of zero weight."""
    (first, slope), *others = [(w, k) for w, k in zip(weights, slopes, strict=True) if w != 0.0]
    total = slope * first
    for weight, slope in others:
        total = total.add(slope, alpha=weight)
    return total
