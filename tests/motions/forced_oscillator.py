"""A system with time and friction: m q'' = -k q - r q' + a sin(w t)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.dynamics.forces import Force, Forcing, Friction
from ahnn.systems import FilterNoise, Range, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class ForcedOscillator(System):
    """A mass on a spring, damped and driven; SI units."""

    stiffness: float = 5.0
    friction: float = 0.4
    amplitude: float = 1.0
    frequency: float = 1.3
    q0: Range = (-1.0, 1.0)

    dof = 1
    components = ("q", "p")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "dopri8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Friction and the drive."""
        drive = Forcing(1, frequency=self.frequency, sine=[self.amplitude])
        return Friction(1, coefficient=self.friction), drive

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2m + k q^2 / 2, shape (...)."""
        q, p = x.unbind(-1)
        return p * p / (2 * self.mass) + self.stiffness * q * q / 2

    def force(self, q: Tensor) -> Tensor:
        """Return -k q, shape (..., 1)."""
        return -self.stiffness * q

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw positions and momenta, shape (count, 2)."""
        return torch.stack([uniform(self.q0, count, generator) for _ in range(2)], dim=-1)
