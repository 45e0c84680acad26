"""Satellites on highly elliptic orbits about an oblate planet: two-body attraction and J2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast, final

import torch
from torch import Tensor

from ahnn.arguments import Finite, Positive
from ahnn.integrators import INTEGRATORS, SymmetricComposition
from ahnn.systems import oblate
from ahnn.systems.satellites import Planet, SatelliteSystem
from ahnn.types import Flow

POLAR = torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64)
"""Additional factor of the oblateness force along the polar axis."""


@final
@dataclass(frozen=True, kw_only=True)
class Molniya(SatelliteSystem):
    """Molniya orbits in an inertial frame (paper, section IV.B); km, km/s, kg.

    Attributes:
        mu: gravitational parameter in km^3/s^2.
        r_eq: equatorial radius in km.
        j2: second zonal harmonic, dimensionless.
    """

    mu: Positive = 398600.4418
    r_eq: Positive = 6378.1363
    j2: Finite = 1.0826e-3

    integrator = "kahan_li8"
    constants = ("mu", "j2")

    @property
    def planet(self) -> Planet:
        """Central planet of the orbital elements."""
        return Planet(self.mu, self.r_eq)

    def energy(self, x: Tensor) -> Tensor:
        """Return T + V with V = -mu/r (1 - J2 (r_eq/r)^2 (3 z^2/r^2 - 1)/2), shape (...)."""
        q, p = x.chunk(2, dim=-1)
        r2 = (q * q).sum(-1)
        oblateness = 0.5 * self.j2 * self.r_eq**2 * (3 * q[..., 2] ** 2 / r2 - 1) / r2
        potential = -self.mass * self.mu / r2.sqrt() * (1 - oblateness)
        return (p * p).sum(-1) / (2 * self.mass) + potential

    def force(self, q: Tensor) -> Tensor:
        """Return the attraction of the oblate planet, shape (..., 3) (Vallado, section 8.7.1)."""
        square = q * q
        inverse = square.sum(-1, keepdim=True).reciprocal()
        sine2 = square[..., 2:3] * inverse
        oblateness = (1.5 * self.j2 * self.r_eq**2) * inverse
        central = inverse * inverse.sqrt() * (-self.mass * self.mu)
        planar = 1 + oblateness * (1 - 5 * sine2)
        return central * (q * torch.addcmul(planar, oblateness, POLAR.to(q)))

    def compiled(self, flow: Flow, longest: float) -> Flow:
        """Return the exact flow, in C if a compiler is available."""
        constants = oblate.OblateAttraction(self.mass, -self.mass * self.mu, 1.5 * self.j2 * self.r_eq**2)
        method = cast(SymmetricComposition, INTEGRATORS[self.integrator])
        return oblate.OblateFlow(flow, constants, method, longest)
