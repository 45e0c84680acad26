"""Measurements of a satellite state [position, velocity] in an inertial frame: ground station and GNSS.

Light time, refraction and polar motion are not modelled. A range-rate needs velocities: a station knows the
mass that turns momenta into them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.measurements.base import wrap

EARTH_RATE = 7.2921150e-5
"""Rotation rate of the Earth in rad/s (IERS Conventions 2010, table 1.2, nominal value)."""

EARTH_RADIUS = 6378.137
"""Equatorial radius of the WGS 84 ellipsoid in km (NIMA TR8350.2)."""

EARTH_FLATTENING = 1.0 / 298.257223563
"""Flattening of the WGS 84 ellipsoid (NIMA TR8350.2)."""


class GroundStation:
    """Range, azimuth, elevation and, if asked for, range-rate seen from a point on a rotating Earth.

    Azimuth counts from north through east, in (-pi, pi]; elevation from the plane normal to the ellipsoid's
    normal, in [-pi/2, pi/2]. Conversions: Vallado 2013, algorithms 27 (range, azimuth, elevation) and 51
    (geodetic site coordinates).

    Args:
        latitude: geodetic, degrees.
        longitude: degrees, positive east.
        height: above the ellipsoid, km.
        range_rate: also measure the range-rate.
        earth_angle: angle of the Greenwich meridian from the inertial x axis at t = 0, rad.
        rotation_rate: of the Earth, rad/s.
        radius: equatorial, km.
        flattening: of the ellipsoid; 0 for a sphere.
        mass: of the satellite in kg; the range-rate is that of the velocity p / mass.

    Raises:
        ValueError: if the latitude is not in [-90, 90], the mass is not positive, or a state is too short.
    """

    def __init__(
        self,
        latitude: float,
        longitude: float,
        height: float = 0.0,
        *,
        range_rate: bool = False,
        earth_angle: float = 0.0,
        rotation_rate: float = EARTH_RATE,
        radius: float = EARTH_RADIUS,
        flattening: float = EARTH_FLATTENING,
        mass: float = 1.0,
    ) -> None:
        if not -90.0 <= latitude <= 90.0:
            message = f"GroundStation: expected a latitude in [-90, 90] degrees, got {latitude}"
            raise ValueError(message)
        if not 0.0 < mass < math.inf:
            message = f"GroundStation: expected a mass > 0 kg, got {mass}"
            raise ValueError(message)
        self.mass = mass
        self.names = ("range", "azimuth", "elevation", *(("range_rate",) if range_rate else ()))
        self.units = ("km", "rad", "rad", *(("km/s",) if range_rate else ()))
        self.latitude = math.radians(latitude)
        self.longitude = math.radians(longitude)
        self.earth_angle = earth_angle
        self.rotation_rate = rotation_rate
        sine = math.sin(self.latitude)
        squared_eccentricity = flattening * (2.0 - flattening)
        normal = radius / math.sqrt(1.0 - squared_eccentricity * sine**2)
        self.equatorial = (normal + height) * math.cos(self.latitude)
        self.polar = (normal * (1.0 - squared_eccentricity) + height) * sine

    def __call__(self, x: Tensor, t: float) -> Tensor:
        """Return [range km, azimuth rad, elevation rad(, range-rate km/s)], (..., M), of x (..., 6)."""
        _check_state(x, 6 if len(self.names) == 4 else 3, "GroundStation")
        angle = self.longitude + self.earth_angle + self.rotation_rate * t
        cosine, sine = math.cos(angle), math.sin(angle)
        site = x.new_tensor((self.equatorial * cosine, self.equatorial * sine, self.polar))
        line = x[..., :3] - site
        east, north, up = (line @ x.new_tensor(self._axes(cosine, sine))).unbind(-1)
        distance = line.square().sum(-1).sqrt()
        elevation = torch.atan2(up, torch.hypot(east, north))
        parts = [distance, wrap(torch.atan2(east, north)), elevation]
        if len(self.names) == 4:
            spin = self.rotation_rate * self.equatorial
            relative = x[..., 3:6] / self.mass - x.new_tensor((-spin * sine, spin * cosine, 0.0))
            parts.append((line * relative).sum(-1) / distance)
        return torch.stack(parts, dim=-1)

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, the azimuth wrapped to (-pi, pi]."""
        difference = y - y_pred
        azimuth = wrap(difference[..., 1:2])
        return torch.cat((difference[..., :1], azimuth, difference[..., 2:]), dim=-1)

    def _axes(self, cosine: float, sine: float) -> tuple[tuple[float, ...], ...]:
        """Return the 3 x 3 matrix whose columns are east, north and up in the inertial frame."""
        cos_lat, sin_lat = math.cos(self.latitude), math.sin(self.latitude)
        return (
            (-sine, -sin_lat * cosine, cos_lat * cosine),
            (cosine, -sin_lat * sine, cos_lat * sine),
            (0.0, cos_lat, sin_lat),
        )


class GnssRange:
    """Pseudoranges to N satellites whose positions are given, in the frame and unit of the state.

    Args:
        positions: (N, 3), or a (T, N, 3) table with one row for each of `times`.
        times: (T,) times of the table, increasing; None for constant positions.
        clock: index of the state component that holds the receiver's clock error as a length; None if the
            ranges are free of it. Counts from the end where it is negative.
        unit: of a range.

    Raises:
        ValueError: if the shapes of positions and times do not fit, a measurement is asked for at a time
            that the table does not hold, or a state has no component `clock`.
    """

    def __init__(
        self,
        positions: Tensor | Sequence,
        times: Tensor | Sequence[float] | None = None,
        *,
        clock: int | None = None,
        unit: str = "km",
    ) -> None:
        table = torch.as_tensor(positions, dtype=torch.float64)
        self.times = None if times is None else torch.as_tensor(times, dtype=torch.float64)
        expected = (3,) if self.times is None else (len(self.times), 3)
        if table.ndim != len(expected) + 1 or (*table.shape[:-2], table.shape[-1]) != expected:
            message = (
                f"GnssRange: expected positions (N, 3) without times, or (T, N, 3) with T times, got "
                f"{tuple(table.shape)} and {'no' if self.times is None else len(self.times)} times"
            )
            raise ValueError(message)
        self.positions = table
        self.clock = clock
        self.names = tuple(f"range{i + 1}" for i in range(table.shape[-2]))
        self.units = (unit,) * table.shape[-2]

    def __call__(self, x: Tensor, t: float) -> Tensor:
        """Return the pseudoranges (..., N) of the states x (..., D) at time t."""
        clock = 0 if self.clock is None else self.clock
        _check_state(x, max(3, clock + 1, -clock), "GnssRange")
        satellites = self._at(t).to(x)
        ranges = (x[..., None, :3] - satellites).square().sum(-1).sqrt()
        return ranges if self.clock is None else ranges + x[..., self.clock, None]

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred."""
        return y - y_pred

    def _at(self, t: float) -> Tensor:
        """Return the satellite positions (N, 3) at time t."""
        if self.times is None:
            return self.positions
        distance = (self.times - t).abs()
        nearest = int(distance.argmin())
        # Times are sums of steps: they agree with the table to rounding, not exactly.
        if float(distance[nearest]) > 1e-9 * max(1.0, abs(t)):
            message = (
                f"GnssRange: expected a time of the table, {self.times[0]:g} to {self.times[-1]:g}, "
                f"got {t:g}; nearest is {self.times[nearest]:g}; tabulate the measurement times"
            )
            raise ValueError(message)
        return self.positions[nearest]


def _check_state(x: Tensor, least: int, who: str) -> None:
    if x.shape[-1] < least:
        message = f"{who}: expected states of at least {least} components, got {tuple(x.shape)}"
        raise ValueError(message)
