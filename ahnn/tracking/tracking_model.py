"""Measurement model of tracking: ranges, range rates and angles, with derivatives by satellite state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ahnn.tracking.accelerations.relativity import LIGHT
from ahnn.tracking.atmospheric_delay import (
    bending,
    bending_by_recommendation,
    laser_delay,
    measured_air,
    radio_delay,
)
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.light_path import LightPath, light_path
from ahnn.tracking.sun_and_moon import MOON_MU, SUN_MU, SunAndMoon
from ahnn.tracking.tracking_data import TrackingData
from ahnn.tracking.tracking_station import EARTH_MU, TrackingStation, tidal_displacement

Array = NDArray[np.float64]
ANGLES = np.array([False, True, False, False, True, False])
"""Mask of `KINDS` that are periodic angles."""


@dataclass(frozen=True, kw_only=True)
class Corrections:
    """Corrections from geometric to measured ranges and angles.

    Attributes:
        troposphere: tropospheric delay of ranges: none, radio or laser.
        refraction: refraction in elevation: none, from weather data, or by ITU-R P.834.
        solid_tides: whether solid Earth tides displace the stations.
        shapiro: whether to apply the relativistic delay of the Earth's field.
        centre_of_mass: distance in km, along the line of sight, from the reflector to the centre of mass;
            measured ranges are shorter by this distance.
    """

    troposphere: Literal["none", "radio", "laser"] = "none"
    refraction: Literal["none", "profile", "p834"] = "none"
    solid_tides: bool = False
    shapiro: bool = False
    centre_of_mass: float = 0.0


class Path(Protocol):
    """Path of a satellite, for the measurement model."""

    def states(self, times: Array) -> Array:
        """Return the states (T, 6) in GCRF, km and km/s, at times (T,)."""
        ...


class PredictedTracking(NamedTuple):
    """Predicted measurements.

    Attributes:
        values: (N, 6) in the order of `KINDS`, km, rad and km/s.
        by_state: derivatives with respect to the satellite's state at the bounce, (N, 6, 6).
        bounce: bounce time, (N,).
        elevation: geometric elevation, (N,) rad.
    """

    values: Array
    by_state: Array
    bounce: Array
    elevation: Array


class TrackingModel:
    """Measurements as functions of the satellite's path.

    Args:
        data: tracking data that provide times, stations and weather.
        stations: stations in the order of the data.
        corrections: corrections to apply.
        rotation: Earth rotation.
        bodies: positions of Sun and Moon.
    """

    def __init__(
        self,
        data: TrackingData,
        stations: tuple[TrackingStation, ...],
        corrections: Corrections,
        rotation: EarthRotation,
        bodies: SunAndMoon,
    ) -> None:
        self.data, self.stations, self.corrections = data, stations, corrections
        self._rotation, self._bodies = rotation, bodies

    def of(self, stations: tuple[TrackingStation, ...], data: TrackingData) -> TrackingModel:
        """Return the model of other stations and measurements."""
        return TrackingModel(data, stations, self.corrections, self._rotation, self._bodies)

    def on(self, rotation: EarthRotation) -> TrackingModel:
        """Return the model with a different rotation of the Earth."""
        return TrackingModel(self.data, self.stations, self.corrections, rotation, self._bodies)

    def site(self, station: TrackingStation, times: Array) -> Array:
        """Return the position of a station in GCRF at times (T,), (T, 3) km."""
        turns, place = self._rotation.matrices(times), np.broadcast_to(station.position, (len(times), 3))
        if self.corrections.solid_tides:
            for position, mu in ((self._bodies.sun(times), SUN_MU), (self._bodies.moon(times), MOON_MU)):
                body = np.einsum("tij,tj->ti", turns, position)
                place = place + tidal_displacement(station.position, body, mu)
        return np.einsum("tji,tj->ti", turns, place)

    def axes(self, station: TrackingStation, times: Array) -> Array:
        """Return the east, north and up unit vectors of a station in GCRF as rows, (T, 3, 3)."""
        return np.einsum("ij,tjk->tik", station.axes, self._rotation.matrices(times))

    def __call__(self, arc: Path) -> PredictedTracking:
        """Predict the measurements of a satellite on an arc."""
        n = len(self.data.times)
        found = PredictedTracking(np.full((n, 6), np.nan), np.zeros((n, 6, 6)), np.empty(n), np.empty(n))
        for k, station in enumerate(self.stations):
            rows = self.data.station == k
            if rows.any():
                for target, part in zip(found, self._of_station(arc, station, rows), strict=True):
                    target[rows] = part
        return found

    def _of_station(self, arc: Path, station: TrackingStation, rows: NDArray[np.bool_]) -> PredictedTracking:
        path = light_path(
            lambda t: arc.states(t)[:, :3],
            lambda t: self.site(station, t),
            self.data.times[rows],
            self.data.event,
        )
        air = measured_air(self.data.weather[rows], station.height)
        axes = self.axes(station, path.receive)
        values, by_state = np.empty((len(path.bounce), 6)), np.zeros((len(path.bounce), 6, 6))
        values[:, 1:3], by_state[:, 1:3, :3] = directions(
            np.einsum("tij,tj->ti", axes, path.down), azimuth=True
        )
        by_state[:, 1:3, :3] = by_state[:, 1:3, :3] @ axes
        values[:, 4:6], by_state[:, 4:6, :3] = directions(path.down, azimuth=False)
        elevation = values[:, 2].copy()
        values[:, 0], by_state[:, 0, :3] = half_round_trip(path)
        values[:, 0] += self._delay(path, elevation, air, station, self.data.wavelength[rows])
        values[:, 3], by_state[:, 3] = self._range_rate(arc, station, path)
        if self.corrections.refraction == "profile":
            values[:, 2] += bending(elevation, air)
        elif self.corrections.refraction == "p834":
            values[:, 2] += bending_by_recommendation(elevation, station.height)
        return PredictedTracking(values, by_state, path.bounce, elevation)

    def _delay(
        self, path: LightPath, elevation: Array, air, station: TrackingStation, wavelength: Array
    ) -> Array:
        """Return the total delay of measured ranges, (T,) km."""
        chosen, place = self.corrections, (station.latitude, station.height)
        delay = np.full(len(elevation), -chosen.centre_of_mass)
        if chosen.troposphere == "radio":
            delay += radio_delay(elevation, air, *place)
        elif chosen.troposphere == "laser":
            delay += laser_delay(elevation, air, wavelength, *place)
        return delay + shapiro(path) if chosen.shapiro else delay

    def _range_rate(self, arc: Path, station: TrackingStation, path: LightPath) -> tuple[Array, Array]:
        """Return the range rate at reception, (T,) km/s, and its derivatives by the state, (T, 6)."""
        drift = (self.site(station, path.receive + 0.5) - self.site(station, path.receive - 0.5)) / 1.0
        relative = arc.states(path.bounce)[:, 3:] - drift
        distance = np.linalg.norm(path.down, axis=1, keepdims=True)
        unit = path.down / distance
        rate = (unit * relative).sum(1)
        return rate, np.concatenate(((relative - rate[:, None] * unit) / distance, unit), axis=1)


def half_round_trip(path: LightPath) -> tuple[Array, Array]:
    """Return half of the two-way path, (T,), and its derivatives by the satellite's position, (T, 3).

    The derivatives neglect the change of the bounce time with position, a relative error of 1e-5.
    """
    up, down = (np.linalg.norm(one, axis=1) for one in (path.up, path.down))
    return 0.5 * (up + down), 0.5 * (path.up / up[:, None] + path.down / down[:, None])


def directions(line: Array, *, azimuth: bool) -> tuple[Array, Array]:
    """Return two angles of lines (T, 3), and their derivatives (T, 2, 3).

    Args:
        line: vector from the station to the satellite, in east, north, up or inertial axes.
        azimuth: whether the first angle, from 0 to 2 pi, runs from the second axis to the first, as azimuth;
            else from the first axis to the second, as right ascension.
    """
    x, y, z = line.T
    level = x**2 + y**2
    sign = 1.0 if azimuth else -1.0
    around = np.arctan2(x, y) if azimuth else np.arctan2(y, x)
    square, flat = level + z**2, np.sqrt(level)
    first = np.column_stack((sign * y / level, -sign * x / level, np.zeros_like(z)))
    second = np.column_stack((-x * z / flat, -y * z / flat, flat)) / square[:, None]
    return np.column_stack((around % (2 * np.pi), np.arctan2(z, flat))), np.stack((first, second), axis=1)


def shapiro(path: LightPath) -> Array:
    """Return the relativistic delay of light in the Earth's field, in km for half the two-way path, (T,).

    One way it is 2 mu / c^2 ln((a + b + d) / (a + b - d)), where a and b are the geocentric distances of the
    ends, and d is their separation (IERS Conventions 2010, 11.17).
    """
    a, distance = np.linalg.norm(path.site, axis=1), np.linalg.norm(path.down, axis=1)
    both = a + np.linalg.norm(path.site + path.down, axis=1)
    return 2 * EARTH_MU / LIGHT**2 * np.log((both + distance) / (both - distance))
