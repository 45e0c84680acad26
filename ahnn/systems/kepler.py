"""Planar Kepler problem in canonical units: mu = semi-major axis = 1, period 2 pi."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.systems.base import Eccentricity, FilterNoise, System, Units, uniform
from ahnn.systems.orbits import Elements, state_at_periapsis


@final
@dataclass(frozen=True, kw_only=True)
class Kepler(System):
    """Planar two-body motion, starting at periapsis with random orientation.

    Attributes:
        eccentricity: range of the eccentricity.
    """

    eccentricity: Eccentricity = (0.0, 0.5)

    dof = 2
    components = ("x", "y", "px", "py")
    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    singular = True
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2m - m / r, shape (...)."""
        q, p = x.chunk(2, dim=-1)
        return (p * p).sum(-1) / (2 * self.mass) - self.mass / q.norm(dim=-1)

    def force(self, q: Tensor) -> Tensor:
        """Return -m q / r^3, shape (..., 2)."""
        return -self.mass * q / q.norm(dim=-1, keepdim=True) ** 3

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw eccentricity and direction of periapsis uniformly, shape (count, 4)."""
        e = uniform(self.eccentricity, count, generator)
        direction = uniform((0.0, 360.0), count, generator)
        zero = torch.zeros_like(e)
        x = state_at_periapsis(Elements(1 - e, e, zero, zero, direction), 1.0, self.mass)
        return x[:, [0, 1, 3, 4]]
