"""Molniya satellites in a gravity field of spherical harmonics, about a possibly rotating planet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, final

import torch
from torch import Tensor

from ahnn.arguments import Finite, Within
from ahnn.errors import UserError
from ahnn.systems.gravity import GravityField, Tide, ggm05c, read_gfc
from ahnn.systems.satellites import Planet, SatelliteSystem
from ahnn.types import Space

Degree = Annotated[int, Within(0)]
TURN = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
"""Maps rows (x, y, z) to (y, -x, 0), the rates of fixed vectors in axes that rotate at 1 rad/s."""


@final
@dataclass(frozen=True, kw_only=True)
class MolniyaGravity(SatelliteSystem):
    """Molniya orbits in the body-fixed axes of a planet rotating about z; km, km/s, kg.

    H = p^2 / 2m + m V(q) - rotation (x p_y - y p_x), with p the mass times inertial velocity, resolved in
    body-fixed axes. H is canonical and conserved (the Jacobi constant) although V rotates in an inertial
    frame. Zonal harmonics are unaffected by rotation: with order 0 and rotation 0, the axes are inertial and
    H = T + V.

    Attributes:
        gravity: `ggm05c` (to degree 8), or the path of a file in ICGEM format.
        degree: highest degree of the harmonics.
        order: highest order of the harmonics.
        rotation: rotation rate of the planet in rad/s; may be 0 only for order 0.
        tide: tide system of the gravity field.
        epoch: epoch of time-variable coefficients, YYYY-MM-DD.
    """

    gravity: str = "ggm05c"
    degree: Degree = 8
    order: Degree = 0
    rotation: Finite = 0.0
    tide: Tide = "zero_tide"
    epoch: str | None = None

    integrator = "dopri8"

    def __post_init__(self) -> None:
        """Raise UserError for invalid orbits or fields."""
        super().__post_init__()
        if self.order > 0 and self.rotation == 0:
            message = (
                f"rotation: expected the rotation rate of the planet for harmonics to order {self.order}, "
                "7.292115e-5 rad/s for the Earth; received 0.0. Only order 0 needs no rotation rate"
            )
            raise UserError(message)

    @cached_property
    def gravity_field(self) -> GravityField:
        """The gravity field."""
        known = ggm05c(self.tide) if self.gravity == "ggm05c" else read_gfc(self.gravity, self.epoch)
        if known.tide != self.tide:
            message = f"tide: expected {known.tide}, as in {self.gravity}; received {self.tide}"
            raise UserError(message)
        return known.cut(self.degree, self.order)

    @property
    def planet(self) -> Planet:
        """Central planet of the orbital elements."""
        return Planet(self.gravity_field.mu, self.gravity_field.radius)

    @property
    def r_eq(self) -> float:
        """Equatorial radius in km, for figures."""
        return self.gravity_field.radius

    @property
    def space(self) -> Space:
        """Description of the state components."""
        return super().space._replace(frame="" if self.separable else "axes of the rotating planet")

    @property
    def separable(self) -> bool:
        """Whether H = T(p) + V(q)."""
        return self.rotation == 0

    def parameters(self) -> dict[str, Any]:
        """Return the complete definition of the equations, including the content of a field file."""
        return {**super().parameters(), "gravity": self.gravity_field.checksum}

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., 6)."""
        q, p = x.chunk(2, dim=-1)
        momentum = q[..., 0] * p[..., 1] - q[..., 1] * p[..., 0]
        kinetic = (p * p).sum(-1) / (2 * self.mass)
        return kinetic + self.mass * self.gravity_field.potential(q) - self.rotation * momentum

    def force(self, q: Tensor) -> Tensor:
        """Return the attraction -m dV/dq, shape (..., 3)."""
        return self.mass * self.gravity_field.attraction(q)

    def hamiltonian(self, x: Tensor) -> Tensor:
        """Return Hamilton's field (dq/dt, dp/dt), shape (..., 6), at the states x, shape (..., 6)."""
        at_rest = super().hamiltonian(x)
        if self.separable:
            return at_rest
        turned = x.unflatten(-1, (2, 3)) @ TURN.to(x)
        return at_rest + self.rotation * turned.flatten(-2)
