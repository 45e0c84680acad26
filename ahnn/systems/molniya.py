"""Satellites on highly elliptic orbits about an oblate planet: two-body attraction and J2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Finite, Positive, Range
from ahnn.errors import UserError
from ahnn.systems.base import Eccentricity, FilterNoise, System, Units, uniform
from ahnn.systems.orbits import Elements, period, state_at_periapsis

POLAR = torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64)
"""How much of the oblateness acts along the polar axis besides."""


@final
@dataclass(frozen=True, kw_only=True)
class Molniya(System):
    """Molniya orbits in an inertial frame (paper, section IV.B); km, km/s, kg.

    The mass is 1 kg, so momenta equal velocities and energies are specific energies.

    Attributes:
        mu: gravitational parameter in km^3/s^2.
        r_eq: equatorial radius in km.
        j2: second zonal harmonic, dimensionless.
        altitude: range of the periapsis altitude in km above r_eq.
        eccentricity: range, dimensionless.
        inclination, raan, argument_of_periapsis: ranges in degrees.
        periods: length of each trajectory in its own two-body periods; None means `steps` for all.
    """

    mu: Positive = 398600.4418
    r_eq: Positive = 6378.1363
    j2: Finite = 1.0826e-3
    altitude: Range = (540.0, 560.0)
    eccentricity: Eccentricity = (0.7, 0.8)
    inclination: Range = (60.0, 66.0)
    raan: Range = (0.0, 0.0)
    argument_of_periapsis: Range = (270.0, 270.0)
    periods: Positive | None = None

    dof = 3
    components = ("x", "y", "z", "px", "py", "pz")
    units = Units(time="s", position="km", velocity="km/s", energy="km²/s²")
    integrator = "kahan_li8"
    noise = FilterNoise(position=10.0**0.5, velocity=1e-3**0.5, measurement=1.0)

    def __post_init__(self) -> None:
        """Refuse what makes no orbit; raises UserError."""
        super().__post_init__()
        if self.altitude[0] <= -self.r_eq:
            message = f"altitude: expected orbits above the centre, -{self.r_eq} km; received {self.altitude}"
            raise UserError(message)

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

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw orbits uniformly in their elements and return their states at periapsis, shape (count, 6)."""
        altitude = uniform(self.altitude, count, generator)
        elements = Elements(
            periapsis=self.r_eq + altitude,
            eccentricity=uniform(self.eccentricity, count, generator),
            inclination=uniform(self.inclination, count, generator),
            raan=uniform(self.raan, count, generator),
            argument_of_periapsis=uniform(self.argument_of_periapsis, count, generator),
        )
        return state_at_periapsis(elements, self.mu, self.mass)

    def phases(self, x: Tensor) -> dict[str, Tensor]:
        """Return which of the states x, shape (..., 6), lie within two equatorial radii of the centre."""
        distance = x[..., :3].norm(dim=-1) / self.r_eq
        return {"inside 2 radii": distance <= 2.0, "outside 2 radii": distance > 2.0}

    def durations(self, x: Tensor) -> Tensor:
        """Return `steps` for all, or the steps that cover `periods` revolutions of each orbit, shape (B,)."""
        if self.periods is None:
            return super().durations(x)
        return torch.ceil(self.periods * period(x, self.mu, self.mass) / self.dt).long()
