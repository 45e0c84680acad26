"""Ground station observing a satellite with state [position, momentum] in an inertial frame.

Refraction is not modelled. Light time is modelled if times tag reception or transmission.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import torch
from torch import Tensor

from ahnn.arguments import Finite, Positive, Within, checked
from ahnn.measurements.angles import Differing, wrap
from ahnn.measurements.base import Time, check_state
from ahnn.measurements.daily_axes import DailyAxes

EARTH_RATE = 7.292115146706979e-5
"""Rate of the Earth rotation angle in rad/s (IERS Conventions 2010, eq. 5.15).

The rounded nominal value, 7.292115e-5, would turn a station by 1 m a day.
"""

EARTH_RADIUS = 6378.137
"""Equatorial radius of the WGS 84 ellipsoid in km (NIMA TR8350.2)."""

EARTH_FLATTENING = 1.0 / 298.257223563
"""Flattening of the WGS 84 ellipsoid (NIMA TR8350.2)."""

LIGHT = 299792.458
"""Speed of light in km/s."""

Event = Literal["bounce", "receive", "transmit"]
"""Events tagged by measurement times: bounce at the satellite, reception or transmission at the station."""
TO_BOUNCE = {"bounce": 0.0, "receive": -1.0, "transmit": 1.0}
"""Number of light times from each event to the bounce."""

Degrees = Annotated[float, Within(-90, 90)]
"""Latitude or elevation in degrees."""


@checked
class GroundStation(Differing):
    """Range, azimuth, elevation and optionally range-rate from a point on the rotating Earth.

    Azimuth is measured from north through east, in (-pi, pi]; elevation from the plane perpendicular to the
    ellipsoid's normal, in [-pi/2, pi/2]. Conversions: Vallado 2013, algorithms 27 (range, azimuth, elevation)
    and 51 (geodetic site coordinates).

    Args:
        latitude: geodetic latitude, degrees.
        longitude: degrees, positive east.
        height: height above the ellipsoid, km.
        range_rate: whether to measure the range-rate.
        earth_angle: angle of the Greenwich meridian from the inertial x axis at t = 0, rad; None for 0. Or
            the (3, 3) matrix from the inertial axes to the Earth's axes at t = 0; the Earth rotates about its
            z axis. `DailyAxes` add precession, nutation and polar motion (`ahnn.tracking.earth_axes`).
        rotation_rate: rotation rate of the Earth, rad/s.
        radius: equatorial radius, km.
        flattening: flattening of the ellipsoid; 0 for a sphere.
        mass: mass of the satellite in kg; the range rate is computed from the velocity p / mass.
        min_elevation: minimum elevation in degrees. 0 is the horizon, -90 means unlimited view.
        event: event tagged by the times of measurements. With `bounce`, geometry is instantaneous. Otherwise
            the two-way light time is included: a range is half the two-way path, and satellite and station
            move with their velocities.

    Raises:
        UserError: a number is not finite or outside its limits.
    """

    def __init__(
        self,
        latitude: Degrees,
        longitude: Finite,
        height: Finite = 0.0,
        *,
        range_rate: bool = False,
        earth_angle: Finite | list[list[float]] | DailyAxes | None = None,
        rotation_rate: Finite = EARTH_RATE,
        radius: Positive = EARTH_RADIUS,
        flattening: Annotated[float, Within(0, below=1)] = EARTH_FLATTENING,
        mass: Positive = 1.0,
        min_elevation: Degrees = 0.0,
        event: Event = "bounce",
    ) -> None:
        self.to_bounce = TO_BOUNCE[event]
        self.mass = mass
        self.min_elevation = math.radians(min_elevation)
        self.names = ("range", "azimuth", "elevation", *(("range_rate",) if range_rate else ()))
        self.units = ("km", "rad", "rad", *(("km/s",) if range_rate else ()))
        self.latitude = math.radians(latitude)
        self.longitude = math.radians(longitude)
        if isinstance(earth_angle, list):
            earth_angle = DailyAxes(torch.tensor([earth_angle], dtype=torch.float64))
        self.axes = earth_angle if isinstance(earth_angle, DailyAxes) else None
        self.earth_angle = 0.0 if earth_angle is None or isinstance(earth_angle, DailyAxes) else earth_angle
        self.rotation_rate = rotation_rate
        sine = math.sin(self.latitude)
        squared_eccentricity = flattening * (2.0 - flattening)
        normal = radius / math.sqrt(1.0 - squared_eccentricity * sine**2)
        self.equatorial = (normal + height) * math.cos(self.latitude)
        self.polar = (normal * (1.0 - squared_eccentricity) + height) * sine

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return [range km, azimuth rad, elevation rad(, range-rate km/s)], (..., M), of x (..., 6).

        Also defined for states below the horizon: see `in_view`.
        """
        check_state(x, 6 if len(self.names) == 4 or self.to_bounce else 3, "GroundStation")
        site, axes, drift = self._frame(x, t)
        line = x[..., :3] - site
        other = line
        if self.to_bounce:
            delay = self.to_bounce * line.square().sum(-1, keepdim=True).sqrt() / LIGHT
            line = line + delay * x[..., 3:6] / self.mass
            other = line - 2 * delay * drift  # from the station at the other end of the path
        east, north, up = (line.unsqueeze(-2) @ axes).squeeze(-2).unbind(-1)
        distance = line.square().sum(-1).sqrt()
        elevation = torch.atan2(up, torch.hypot(east, north))
        ranged = 0.5 * (distance + other.square().sum(-1).sqrt()) if self.to_bounce else distance
        parts = [ranged, wrap(torch.atan2(east, north)), elevation]
        if len(self.names) == 4:
            relative = x[..., 3:6] / self.mass - drift
            parts.append((line * relative).sum(-1) / distance)
        return torch.stack(parts, dim=-1)

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions (..., 3) in km that correspond to y (..., M)."""
        distance, azimuth, elevation = y[..., :3].unbind(-1)
        level = distance * elevation.cos()
        local = torch.stack((level * azimuth.sin(), level * azimuth.cos(), distance * elevation.sin()), -1)
        site, axes, _ = self._frame(y, t)
        return site + (axes @ local.unsqueeze(-1)).squeeze(-1)

    def in_view(self, x: Tensor, t: Time) -> Tensor:
        """Return whether the states x (..., D) are at or above the minimum elevation, (..., M) bool."""
        seen = self(x, t)
        return (seen[..., 2:3] >= self.min_elevation).expand_as(seen)

    def _frame(self, like: Tensor, t: Time) -> tuple[Tensor, Tensor, Tensor]:
        """Return the station's inertial position, axes (east, north, up as columns) and velocity.

        Shapes (..., 3), (..., 3, 3) and (..., 3), leading dimensions as for t.
        """
        angle = self.longitude + self.earth_angle + self.rotation_rate * torch.as_tensor(t, dtype=like.dtype)
        cosine, sine = angle.cos(), angle.sin()
        none, one = torch.zeros_like(angle), torch.ones_like(angle)
        level = torch.stack((cosine, sine, none), -1)
        east, pole = torch.stack((-sine, cosine, none), -1), torch.stack((none, none, one), -1)
        cos_lat, sin_lat = math.cos(self.latitude), math.sin(self.latitude)
        north, up = cos_lat * pole - sin_lat * level, cos_lat * level + sin_lat * pole
        site = self.equatorial * level + self.polar * pole
        axes, drift = torch.stack((east, north, up), -1), self.rotation_rate * self.equatorial * east
        if self.axes is None:
            return site, axes, drift
        if self.axes.pole is not None:
            tilt = self.axes.tilt(angle - self.longitude, t, like)
            site = site + torch.linalg.cross(tilt, site)
            axes = axes + torch.linalg.cross(tilt.unsqueeze(-1), axes, dim=-2)
        earth = self.axes.at(t, like)
        site, drift = (torch.stack((site, drift), -2) @ earth).unbind(-2)
        return site, earth.mT @ axes, drift
