"""Pole on a driven cart: q = (x, theta), theta from the upward vertical."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Count, NonNegative, Positive, Range
from ahnn.dynamics.forces import Actuation, Force
from ahnn.systems.base import FilterNoise, Units, uniform
from ahnn.systems.generalised_coordinates import MassMatrixSystem


@final
@dataclass(frozen=True, kw_only=True)
class CartPole(MassMatrixSystem):
    """Point mass on a rigid rod on a cart, without friction (Barto, Sutton & Anderson 1983).

    Attributes:
        mass: mass of the cart in kg.
        pole: mass at the end of the rod in kg.
        length: length of the rod in m.
        gravity: acceleration in m/s^2.
        x0: range of the initial position in m; the cart is at rest.
        angle0: range of the initial angle in rad; the pole is at rest.
        push: standard deviation of the force on the cart in N, drawn anew after every `held` samples.
        held: number of samples for which a force is constant.
    """

    pole: Positive = 0.1
    length: Positive = 0.5
    gravity: Positive = 9.81
    x0: Range = (-1.0, 1.0)
    angle0: Range = (1.0, 5.2)
    push: NonNegative = 1.0
    held: Count = 10

    dof = 2
    components = ("x", "theta", "px", "ptheta")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)
    controls = ("u",)
    angles = ("theta",)

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Driving force on the cart."""
        return (Actuation(2, 1, matrix=[[1.0], [0.0]]),)

    def signal(self, times: Tensor, count: int, generator: Generator) -> Tensor:
        """Draw piecewise constant forces in N, shape (count, T, 1)."""
        draws = torch.randn(count, -(-len(times) // self.held), 1, generator=generator, dtype=torch.float64)
        return self.push * draws.repeat_interleave(self.held, dim=1)[:, : len(times)]

    def mass_matrix(self, q: Tensor) -> Tensor:
        """Return [[M + m, m l cos theta], [m l cos theta, m l^2]], shape (..., 2, 2)."""
        cross = self.pole * self.length * q[..., 1].cos()
        one = torch.ones_like(cross)
        rows = (self.mass + self.pole) * one, cross, cross, self.pole * self.length**2 * one
        return torch.stack(rows, dim=-1).unflatten(-1, (2, 2))

    def mass_slopes(self, q: Tensor) -> Tensor:
        """Return dM/dx = 0 and dM/dtheta, shape (..., 2, 2, 2)."""
        slope = -self.pole * self.length * q[..., 1].sin()
        none = torch.zeros_like(slope)
        return torch.stack((*[none] * 5, slope, slope, none), dim=-1).unflatten(-1, (2, 2, 2))

    def potential(self, q: Tensor) -> Tensor:
        """Return m g l cos theta in J, shape (...)."""
        return self.pole * self.gravity * self.length * q[..., 1].cos()

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq = (0, m g l sin theta), shape (..., 2)."""
        turning = self.pole * self.gravity * self.length * q[..., 1].sin()
        return torch.stack((torch.zeros_like(turning), turning), dim=-1)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw position and angle uniformly, at rest, shape (count, 4)."""
        q = torch.stack([uniform(part, count, generator) for part in (self.x0, self.angle0)], dim=-1)
        return torch.cat((q, torch.zeros_like(q)), dim=-1)
