"""A system: the Duffing oscillator, H = p^2 / 2m + a q^2 / 2 + b q^4 / 4."""

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.systems import FilterNoise, Range, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class Duffing(System):
    """A mass on a spring that stiffens; SI units."""

    a: float = 1.0
    b: float = 2.0
    q0: Range = (-1.0, 1.0)

    dof = 1
    components = ("q", "p")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-2, velocity=1e-2, measurement=1e-2)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), of the states x, shape (..., 2)."""
        q, p = x.unbind(-1)
        return p**2 / (2 * self.mass) + self.a * q**2 / 2 + self.b * q**4 / 4

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq, shape (..., 1)."""
        return -self.a * q - self.b * q**3

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw positions at rest, shape (count, 2)."""
        q = uniform(self.q0, count, generator)
        return torch.stack((q, torch.zeros_like(q)), dim=-1)
