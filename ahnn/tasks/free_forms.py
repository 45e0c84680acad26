"""Equations of motion of known form with free constants, for floors of tasks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import torch
from torch import Tensor

from ahnn.arguments import Finite
from ahnn.systems import FilterNoise, System, Units
from ahnn.tasks.definition import states

NEAR, FAR = 0.3, 0.6
"""Starts have squared distances from the origin between NEAR^2 and NEAR^2 + FAR^2."""


def begin(count: int, size: int, generator: np.random.Generator) -> Tensor:
    """Return starts (count, size) in random directions at random distances from the origin."""
    direction = generator.uniform(-1, 1, (count, size))
    radius = np.sqrt(NEAR**2 + FAR**2 * generator.random(count))
    return states(direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius[:, None])


@dataclass(frozen=True, kw_only=True)
class PlanarForm(System):
    """Unit mass in a planar potential, with starts from `begin`."""

    dof = 2
    components = ("q1", "q2", "p1", "p2")
    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def initial_states(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw states of the task, shape (count, 4)."""
        return begin(count, 4, np.random.default_rng(int(torch.randint(2**31, (), generator=generator))))


@final
@dataclass(frozen=True, kw_only=True)
class StiffChain(PlanarForm):
    """The Fermi-Pasta-Ulam-Tsingou chain of alternating soft and stiff springs, with one stiff spring.

    V = w^2 q_2^2 / 2 + s ((q_1 - q_2)^4 + (q_1 + q_2)^4) / 4 (Hairer, Lubich & Wanner, Geometric Numerical
    Integration, section I.5.1, m = 1): q_1 is the middle of the stiff spring, q_2 its elongation.

    Attributes:
        stiffness: w.
        softness: s.
    """

    stiffness: Finite = 2.0
    softness: Finite = 1.0

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...)."""
        a, b = x[..., 0], x[..., 1]
        kinetic = x[..., 2:].square().sum(-1) / 2
        return kinetic + (self.stiffness * b).square() / 2 + self.softness * ((a - b) ** 4 + (a + b) ** 4) / 4

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq, shape (..., 2)."""
        a, b = q.unbind(-1)
        less, more = self.softness * (a - b) ** 3, self.softness * (a + b) ** 3
        return torch.stack((-less - more, -(self.stiffness**2) * b + less - more), dim=-1)


@final
@dataclass(frozen=True, kw_only=True)
class CubicWell(PlanarForm):
    """V = (a x^2 + b y^2) / 2 + c x^2 y - d y^3 / 3; Hénon-Heiles if all coefficients are 1.

    Attributes:
        a, b, c, d: coefficients of the terms.
    """

    a: Finite = 1.0
    b: Finite = 1.0
    c: Finite = 1.0
    d: Finite = 1.0

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...)."""
        q, r = x[..., 0], x[..., 1]
        quadratic = (x[..., 2:].square().sum(-1) + self.a * q**2 + self.b * r**2) / 2
        return quadratic + self.c * q**2 * r - self.d * r**3 / 3

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq, shape (..., 2)."""
        x, y = q.unbind(-1)
        pull = -self.a * x - 2 * self.c * x * y
        return torch.stack((pull, -self.b * y - self.c * x**2 + self.d * y**2), dim=-1)
