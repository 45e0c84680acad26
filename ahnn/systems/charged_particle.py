"""Charged particle in a plane with a perpendicular magnetic field: H = |p - q A|^2 / 2m + k r^2 / 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Finite, NonNegative, Range
from ahnn.systems.base import FilterNoise, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class ChargedParticle(System):
    """Charge with canonical momenta p = m v + q A, in a field that grows as B (1 + g r^2 / 2).

    Velocities are not proportional to momenta. SI units.

    Attributes:
        charge: charge in C.
        field: B at the centre in T.
        growth: g in 1/m^2; 0 for a uniform field, positive for a magnetic bottle.
        stiffness: k in N/m of a trap about the centre.
        x0: range of each initial position in m.
        v0: range of each initial velocity in m/s.
    """

    charge: Finite = 1.0
    field: Finite = 1.0
    growth: NonNegative = 0.0
    stiffness: NonNegative = 0.0
    x0: Range = (-1.0, 1.0)
    v0: Range = (-1.0, 1.0)

    dof = 2
    components = ("x", "y", "px", "py")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "dopri8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @property
    def separable(self) -> bool:
        """False: H is not a sum T(p) + V(q)."""
        return False

    def magnetic_momentum(self, q: Tensor) -> Tensor:
        """Return q A in kg m/s, shape (..., 2), at the positions q, shape (..., 2).

        A = B (1 + g r^2 / 4) (-y, x) / 2 has the curl B (1 + g r^2 / 2).
        """
        turned = torch.stack((-q[..., 1], q[..., 0]), dim=-1)
        return self.charge * self.field / 2 * self._growth(q) * turned

    def velocities(self, x: Tensor) -> Tensor:
        """Return dq/dt = (p - q A) / m in m/s, shape (..., 2), at the states x, shape (..., 4)."""
        q, p = x.chunk(2, dim=-1)
        return (p - self.magnetic_momentum(q)) / self.mass

    def states(self, q: Tensor, v: Tensor) -> Tensor:
        """Return the states (q, m v + q A), shape (..., 4), of positions and velocities, shape (..., 2)."""
        return torch.cat((q, self.mass * v + self.magnetic_momentum(q)), dim=-1)

    def energy(self, x: Tensor) -> Tensor:
        """Return m v^2 / 2 + k r^2 / 2 in J, shape (...)."""
        q, v = x.chunk(2, dim=-1)[0], self.velocities(x)
        return self.mass * (v * v).sum(-1) / 2 + self.stiffness * (q * q).sum(-1) / 2

    def force(self, q: Tensor) -> Tensor:
        """Return the force of the trap in N, shape (..., 2)."""
        return -self.stiffness * q

    def hamiltonian(self, x: Tensor) -> Tensor:
        """Return (v, sum_j v_j d(q A_j)/dq - k q), shape (..., 4)."""
        q, v = x.chunk(2, dim=-1)[0], self.velocities(x)
        half = self.charge * self.field / 2
        across = q[..., :1] * v[..., 1:] - q[..., 1:] * v[..., :1]  # x v_y - y v_x
        turned = torch.stack((v[..., 1], -v[..., 0]), dim=-1)
        magnetic = half * (self._growth(q) * turned + self.growth / 2 * across * q)
        return torch.cat((v, magnetic + self.force(q)), dim=-1)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw positions and velocities uniformly, shape (count, 4)."""
        q, v = (uniform(part, 2 * count, generator).reshape(count, 2) for part in (self.x0, self.v0))
        return self.states(q, v)

    def _growth(self, q: Tensor) -> Tensor:
        """Return 1 + g r^2 / 4, shape (..., 1)."""
        return 1 + self.growth / 4 * (q * q).sum(-1, keepdim=True)
