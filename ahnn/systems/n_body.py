"""Gravitational N-body problem in the plane: H = sum p_i^2 / 2 m_i - sum G m_i m_j / |q_i - q_j|."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Count, NonNegative, Positive, Range
from ahnn.errors import UserError
from ahnn.systems.base import FilterNoise, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class NBody(System):
    """Point masses in the plane, starting near a rotating regular polygon (Greydanus et al. 2019, section 5).

    Attributes:
        bodies: number of bodies, at least two.
        masses: masses of the bodies; None for 1 each.
        gravity: gravitational constant G.
        radius: range of the initial distance from the centre.
        disorder: maximum relative deviation of velocity components from circular ones.
    """

    bodies: Count = 3
    masses: list[Positive] | None = None
    gravity: Positive = 1.0
    radius: Range = (0.9, 1.2)
    disorder: NonNegative = 0.2

    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    singular = True
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def __post_init__(self) -> None:
        """Raise UserError for invalid parameters."""
        super().__post_init__()
        if self.bodies < 2:
            message = f"bodies: expected at least two; received {self.bodies}"
            raise UserError(message)
        if self.masses is not None and len(self.masses) != self.bodies:
            message = f"masses: expected one number for each of {self.bodies} bodies; received {self.masses}"
            raise UserError(message)

    @property
    def dof(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Two per body."""
        return 2 * self.bodies

    @property
    def components(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Names x1, y1, x2, ... and their momenta."""
        names = [f"{axis}{k + 1}" for k in range(self.bodies) for axis in "xy"]
        return (*names, *(f"p{name}" for name in names))

    @property
    def weights(self) -> list[float]:
        """Masses of the bodies."""
        return self.masses or [self.mass] * self.bodies

    @property
    def inertia(self) -> tuple[float, ...]:
        """Mass of each coordinate."""
        return tuple(mass for mass in self.weights for _ in "xy")

    def between(self, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return q_i - q_j, (..., N, N, 2), distances and G m_i m_j, (..., N, N), 1 and 0 where i = j."""
        bodies = q.unflatten(-1, (self.bodies, 2))
        apart = bodies.unsqueeze(-2) - bodies.unsqueeze(-3)
        own = torch.eye(self.bodies).to(q)
        masses = torch.tensor(self.weights).to(q)
        product = self.gravity * masses[:, None] * masses * (1 - own)
        return apart, (apart.square().sum(-1) + own).sqrt(), product

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...)."""
        q, p = x.chunk(2, dim=-1)
        _, r, product = self.between(q)
        kinetic = (p * self.velocity(p)).sum(-1) / 2
        return kinetic - (product / r).sum((-1, -2)) / 2

    def force(self, q: Tensor) -> Tensor:
        """Return the attraction of each body by all other bodies, shape (..., 2N)."""
        apart, r, product = self.between(q)
        return -(product / r**3).unsqueeze(-1).mul(apart).sum(-2).flatten(-2)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw polygons at random angles and distances with nearly circular velocities, shape (count, 4N)."""
        radius = uniform(self.radius, count, generator)
        angle = uniform((0.0, 2 * math.pi), count, generator)
        each = angle[:, None] + 2 * math.pi * torch.arange(self.bodies, dtype=torch.float64) / self.bodies
        outwards = torch.stack((each.cos(), each.sin()), dim=-1)
        along = torch.stack((-each.sin(), each.cos()), dim=-1)
        # Regular polygon of mean mass m: v^2 = G m / (4 r) sum of 1 / sin(pi k / N).
        pull = sum(1 / math.sin(math.pi * k / self.bodies) for k in range(1, self.bodies)) / 4
        mean = sum(self.weights) / self.bodies
        speed = (self.gravity * mean * pull / radius).sqrt()[:, None, None]
        off = uniform((-self.disorder, self.disorder), count * self.dof, generator)
        v = speed * along * (1 + off.reshape(count, self.bodies, 2))
        q = radius[:, None, None] * outwards
        p = v * torch.tensor(self.weights, dtype=torch.float64)[:, None]
        return torch.cat((q.flatten(1), p.flatten(1)), dim=-1)
