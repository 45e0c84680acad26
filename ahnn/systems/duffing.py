"""Duffing oscillator: m q'' = -a q - b q^3 - r q' + f cos(w t)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Finite, NonNegative, Positive, Range
from ahnn.dynamics.forces import Force, Forcing, Friction
from ahnn.systems.base import FilterNoise, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class Duffing(System):
    """Mass in a double well, with friction and a drive; chaotic for the default values.

    Defaults as in Guckenheimer & Holmes, Nonlinear Oscillations, section 2.2, m = 1 (no units).

    Attributes:
        linear_stiffness: a; negative for a double well.
        cubic_stiffness: b.
        friction: r; 0 for no friction.
        drive: amplitude f; 0 for no drive.
        frequency: w of the drive.
        q0: range of the initial position.
        v0: range of the initial velocity.
    """

    linear_stiffness: Finite = -1.0
    cubic_stiffness: Positive = 1.0
    friction: NonNegative = 0.25
    drive: Finite = 0.3
    frequency: Positive = 1.0
    q0: Range = (-1.5, 1.5)
    v0: Range = (-0.5, 0.5)

    dof = 1
    components = ("q", "p")
    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "dopri8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Friction and drive, if nonzero."""
        found: list[Force] = [Friction(1, coefficient=self.friction)] if self.friction else []
        return [*found, Forcing(1, frequency=self.frequency, cosine=[self.drive])] if self.drive else found

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2m + a q^2 / 2 + b q^4 / 4, shape (...)."""
        q, p = x.unbind(-1)
        potential = self.linear_stiffness * q**2 / 2 + self.cubic_stiffness * q**4 / 4
        return p * p / (2 * self.mass) + potential

    def force(self, q: Tensor) -> Tensor:
        """Return -a q - b q^3, shape (..., 1)."""
        return -self.linear_stiffness * q - self.cubic_stiffness * q**3

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw position and velocity uniformly, shape (count, 2)."""
        q, v = uniform(self.q0, count, generator), uniform(self.v0, count, generator)
        return torch.stack((q, self.mass * v), dim=-1)
