"""Two-stage Gauss-Legendre method: implicit, symplectic for any Hamiltonian, order 4."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from ahnn.arguments import Within, checked
from ahnn.errors import UserError
from ahnn.integrators.base import Integrator, column
from ahnn.types import TimeStep, VectorField

# Hairer, Lubich & Wanner, Geometric Numerical Integration (2006), table II.1.1.
_A12 = 0.25 - math.sqrt(3) / 6
_A21 = 0.25 + math.sqrt(3) / 6


@checked
@dataclass(frozen=True)
class GaussLegendre4(Integrator):
    """Gauss-Legendre Runge-Kutta method of order 4, whose stages are solved by fixed-point iteration.

    Attributes:
        tolerance: a member is solved when no component of dt * slope changes by more than this, relative
            to the larger of the component and dt * slope, or when the change has stopped shrinking at
            round-off level of the positions and momenta.
        max_iterations: number of sweeps after which an unsolved member raises an error.
    """

    tolerance: Annotated[float, Within(above=0, below=1)] = 1e-14
    max_iterations: Annotated[int, Within(1, 1000)] = 50
    name: str = "gl4"
    order: int = 4

    def round_off(self, dtype: torch.dtype) -> float:
        """Return the relative change at or below which a change that does not shrink is rounding."""
        return 64 * torch.finfo(dtype).eps

    def increment(self, field: VectorField, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the increment of one step, shape (..., D).

        Converged members are frozen, so that results are independent of other members. A non-finite member
        stays non-finite and does not delay the rest.

        Raises:
            UserError: the iteration did not converge within `max_iterations`.
        """
        h = column(dt)
        k1 = k2 = field(x)
        size = torch.maximum(x.abs(), (h * k1).abs())
        round_off = self.round_off(x.dtype)
        change = previous = torch.full_like(x[..., 0], torch.inf)
        waiting = torch.ones_like(change, dtype=torch.bool)
        for _ in range(self.max_iterations):
            new1 = field(x + h * (0.25 * k1 + _A12 * k2))
            new2 = field(x + h * (_A21 * k1 + 0.25 * k2))
            shift = (h * torch.maximum((new1 - k1).abs(), (new2 - k2).abs())).abs()
            k1 = torch.where(waiting.unsqueeze(-1), new1, k1)
            k2 = torch.where(waiting.unsqueeze(-1), new2, k2)
            size = torch.maximum(size, (h * k1).abs())
            change = torch.where(shift == 0, 0.0, shift / _of_block(size)).amax(-1)
            solved = (shift <= self.tolerance * size).all(-1)
            stagnant = (change >= previous) & (change <= round_off)
            waiting = waiting & ~solved & ~stagnant & change.isfinite()
            previous = change
            if not waiting.any():
                return 0.5 * h * (k1 + k2)
        largest = float(change.detach()[waiting].max())
        message = (
            f"integrator gl4: the stages of {int(waiting.sum())} of {waiting.numel()} states did not "
            f"converge in {self.max_iterations} sweeps (largest change {largest:.2e}); "
            "shorten the time step or raise max_iterations"
        )
        raise UserError(message)


def _of_block(size: Tensor) -> Tensor:
    """Return, for each component, the largest size in its block, positions or momenta, shape (..., D).

    The blocks may have different units.
    """
    blocks = size.unflatten(-1, (2, -1)) if size.shape[-1] % 2 == 0 else size.unsqueeze(-2)
    return blocks.amax(-1, keepdim=True).expand_as(blocks).flatten(-2)
