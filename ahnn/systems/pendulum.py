"""Plane pendulum: H = p^2 / 2 m l^2 + m g l (1 - cos q)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from ahnn.arguments import Positive, Range
from ahnn.systems.base import FilterNoise, System, Units, uniform


@dataclass(frozen=True, kw_only=True)
class Pendulum(System):
    """Point mass on a rigid rod; the coordinate is the angle from the downward vertical.

    Attributes:
        length: length of the rod in m.
        gravity: acceleration in m/s^2.
        q0: range of the initial angle in rad; the pendulum starts at rest.
    """

    length: Positive = 1.0
    gravity: Positive = 9.81
    q0: Range = (-2.0, 2.0)

    dof = 1
    components = ("q", "p")
    units = Units(time="s", position="rad", velocity="rad/s", energy="J")
    integrator = "kahan_li8"
    constants = ("gravity",)
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2 m l^2 + m g l (1 - cos q) in J, shape (...)."""
        q, p = x.unbind(-1)
        return p * p / (2 * self.inertia) + self.mass * self.gravity * self.length * (1 - q.cos())

    @property
    def inertia(self) -> float:
        """Moment of inertia m l^2 in kg m^2."""
        return self.mass * self.length**2

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt = -m g l sin q in N m, shape (..., 1)."""
        return -self.mass * self.gravity * self.length * q.sin()

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw the angle uniformly, at rest, shape (count, 2)."""
        q = uniform(self.q0, count, generator)
        return torch.stack((q, torch.zeros_like(q)), dim=-1)
