"""Base class of satellites of a planet, with random orbital elements, for any gravity model."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from ahnn.arguments import Positive, Range
from ahnn.errors import UserError
from ahnn.systems.base import Eccentricity, FilterNoise, System, Units, uniform
from ahnn.systems.orbits import Elements, period, state_at_periapsis


class Planet(NamedTuple):
    """Central planet to which orbital elements refer.

    Attributes:
        mu: gravitational parameter in km^3/s^2.
        radius: equatorial radius in km.
    """

    mu: float
    radius: float


@dataclass(frozen=True, kw_only=True)
class SatelliteSystem(System):
    """Orbits that start at periapsis; km, km/s, kg.

    The mass is 1 kg, so momenta equal velocities and energies are specific energies.

    Attributes:
        altitude: range of the periapsis altitude in km above the equatorial radius.
        eccentricity: range of the eccentricity.
        inclination: range in degrees.
        raan: range of the right ascension of the ascending node, in degrees.
        argument_of_periapsis: range in degrees.
        periods: length of each trajectory in two-body periods; None: all trajectories have `steps` steps.
    """

    altitude: Range = (540.0, 560.0)
    eccentricity: Eccentricity = (0.7, 0.8)
    inclination: Range = (60.0, 66.0)
    raan: Range = (0.0, 0.0)
    argument_of_periapsis: Range = (270.0, 270.0)
    periods: Positive | None = None

    dof = 3
    components = ("x", "y", "z", "px", "py", "pz")
    units = Units(time="s", position="km", velocity="km/s", energy="km²/s²")
    noise = FilterNoise(position=10.0**0.5, velocity=1e-3**0.5, measurement=1.0)

    def __post_init__(self) -> None:
        """Raise UserError for invalid orbits."""
        super().__post_init__()
        radius = self.planet.radius
        if self.altitude[0] <= -radius:
            message = (
                f"altitude: expected orbits above the centre of the body, at -{radius} km; received "
                f"{self.altitude}"
            )
            raise UserError(message)

    @property
    @abstractmethod
    def planet(self) -> Planet:
        """Central planet of the orbital elements."""

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw orbital elements uniformly and return states at periapsis, shape (count, 6)."""
        altitude = uniform(self.altitude, count, generator)
        elements = Elements(
            periapsis=self.planet.radius + altitude,
            eccentricity=uniform(self.eccentricity, count, generator),
            inclination=uniform(self.inclination, count, generator),
            raan=uniform(self.raan, count, generator),
            argument_of_periapsis=uniform(self.argument_of_periapsis, count, generator),
        )
        return state_at_periapsis(elements, self.planet.mu, self.mass)

    def phases(self, x: Tensor) -> dict[str, Tensor]:
        """Return the mask of states x, shape (..., 6), within two equatorial radii of the centre."""
        distance = x[..., :3].norm(dim=-1) / self.planet.radius
        return {"inside 2 radii": distance <= 2.0, "outside 2 radii": distance > 2.0}

    def durations(self, x: Tensor) -> Tensor:
        """Return `steps` for all, or the steps that cover `periods` revolutions of each orbit, shape (B,)."""
        if self.periods is None:
            return super().durations(x)
        return torch.ceil(self.periods * period(x, self.planet.mu, self.mass) / self.dt).long()
