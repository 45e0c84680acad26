"""A system with a control: a mass on a spring that somebody pushes; a push is held between samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.dynamics.forces import Actuation, Force
from ahnn.systems import FilterNoise, System, Units


@final
@dataclass(frozen=True, kw_only=True)
class PushedSpring(System):
    """m q'' = -k q + g u; SI units."""

    stiffness: float = 5.0
    gain: float = 2.0

    dof = 1
    components = ("q", "p")
    controls = ("u",)
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "dopri8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @cached_property
    def forces(self) -> Sequence[Force]:
        """The push."""
        return (Actuation(1, 1, matrix=[[self.gain]]),)

    def signal(self, times: Tensor, count: int, generator: Generator) -> Tensor:
        """Draw pushes that last ten samples, shape (count, T, 1)."""
        pushes = torch.randn(count, -(-len(times) // 10), 1, generator=generator, dtype=torch.float64)
        return pushes.repeat_interleave(10, dim=1)[:, : len(times)]

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2m + k q^2 / 2, shape (...)."""
        q, p = x.unbind(-1)
        return p * p / (2 * self.mass) + self.stiffness * q * q / 2

    def force(self, q: Tensor) -> Tensor:
        """Return -k q, shape (..., 1)."""
        return -self.stiffness * q

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw positions and momenta, shape (count, 2)."""
        return 2 * torch.rand(count, 2, generator=generator, dtype=torch.float64) - 1
