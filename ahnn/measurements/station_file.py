"""Any number of ground stations in one YAML file: their coordinates, measured kinds, noise and biases.

A file with two stations:

    kiruna:
      latitude: 67.86            # degrees, geodetic
      longitude: 20.96
      height: 400                # m
      min_elevation: 10          # degrees
      event: receive             # or transmit; times tag this event. Default: bounce, without light time
      noise: {range: 0.05, azimuth: 0.006, elevation: 0.006}   # km, degrees, km/s; these kinds are measured
      bias: {range: 0.02}        # known biases of these kinds
      bias_sd: {range: 0.1}      # standard deviations of biases to estimate
    troll: [-72.0, 2.5, 1270]    # latitude, longitude, height
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ahnn.arguments import Finite, check_arguments, nearest
from ahnn.contents import read_plain
from ahnn.errors import UserError
from ahnn.measurements.angles import Differing
from ahnn.measurements.base import Time
from ahnn.measurements.daily_axes import DailyAxes
from ahnn.measurements.ground_station import Degrees, Event, GroundStation
from ahnn.measurements.several import Several

SEEN = ("range", "azimuth", "elevation", "range_rate")
FACTORS = {"azimuth": math.pi / 180, "elevation": math.pi / 180}
"""Conversion factors from the units of the file."""


@dataclass(frozen=True, kw_only=True)
class StationEntry:
    """A station of a file.

    Attributes:
        latitude, longitude: geodetic, degrees.
        height: height above the ellipsoid in m.
        min_elevation: minimum elevation in degrees.
        event: event tagged by measurement times; None if not stated.
        noise: standard deviations by kind, in km, degrees and km/s.
        bias: known biases, likewise.
        bias_sd: standard deviations of the biases, likewise.
    """

    latitude: Degrees
    longitude: Finite
    height: Finite = 0.0
    min_elevation: Degrees = 0.0
    event: Event | None = None
    noise: dict[str, float] = field(default_factory=dict)
    bias: dict[str, float] = field(default_factory=dict)
    bias_sd: dict[str, float] = field(default_factory=dict)

    def numbers(self, kind: str, other: float = 0.0) -> list[float]:
        """Return `noise`, `bias` or `bias_sd` for each of `SEEN`, in km, rad, km/s; `other` where missing."""
        given = getattr(self, kind)
        return [given[name] * FACTORS.get(name, 1.0) if name in given else other for name in SEEN]


def read_stations(path: str | Path) -> dict[str, StationEntry]:
    """Return the stations of a file. An invalid entry raises UserError, which names it."""
    found = read_plain(Path(path), "stations")
    return {name: entry_of(value, f"{path}: {name}") for name, value in found.items()}


def entry_of(value: Any, who: str) -> StationEntry:
    """Build a station from plain values; raises UserError if they are invalid."""
    if isinstance(value, list) and len(value) == 3:
        value = dict(zip(("latitude", "longitude", "height"), value, strict=True))
    if not isinstance(value, Mapping):
        message = f"{who}: expected [latitude, longitude, height] in degrees and m, or keys; received {value}"
        raise UserError(message)
    check_arguments(who, StationEntry, value)
    entry = StationEntry(**value)
    for kind in ("noise", "bias", "bias_sd"):
        for name, number in getattr(entry, kind).items():
            if name not in SEEN:
                message = (
                    f"{who}.{kind}: expected one of {', '.join(SEEN)}; received {name!r}{nearest(name, SEEN)}"
                )
                raise UserError(message)
            if not (math.isfinite(number) if kind == "bias" else number > 0):
                wanted = "a number" if kind == "bias" else "a number > 0"
                message = f"{who}.{kind}.{name}: expected {wanted}; received {number}"
                raise UserError(message)
    return entry


class BiasedStation(Differing):
    """Station of a file with its known biases; it measures the kinds for which `noise` is given.

    Args:
        entry: entry of the file.
        earth_angle: see `GroundStation`.
        mass: mass of the satellite in kg.
        who: prefix of messages.

    Raises:
        UserError: the station measures nothing.
    """

    def __init__(
        self,
        entry: StationEntry,
        earth_angle: float | list[list[float]] | DailyAxes | None = None,
        mass: float = 1.0,
        who: str = "",
    ) -> None:
        kept = [k for k, name in enumerate(SEEN) if name in entry.noise]
        if not kept:
            message = (
                f"{who}noise: expected standard deviations of one or more of {', '.join(SEEN)}; received none"
            )
            raise UserError(message)
        place = entry.latitude, entry.longitude, entry.height / 1e3
        self.event: Event = entry.event or "bounce"
        self.station = GroundStation(
            *place,
            range_rate=True,
            earth_angle=earth_angle,
            mass=mass,
            min_elevation=entry.min_elevation,
            event=self.event,
        )
        self.kept, self.mass = kept, mass
        self.names = tuple(SEEN[k] for k in kept)
        self.units = tuple(self.station.units[k] for k in kept)
        self.bias = [entry.numbers("bias")[k] for k in kept]
        self.deviations = [entry.numbers("noise")[k] for k in kept]
        self.bias_sd = [entry.numbers("bias_sd")[k] for k in kept]

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D) at time t, in view or not."""
        return self.station(x, t)[..., self.kept] + torch.tensor(self.bias).to(x)

    def in_view(self, x: Tensor, t: Time) -> Tensor:
        """Return whether the states x (..., D) are at or above the minimum elevation, (..., M) bool."""
        return self.station.in_view(x, t)[..., self.kept]

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions (..., 3) in km that produce y (..., M); NaN unless all kinds are measured."""
        whole = y.new_full((*y.shape[:-1], len(SEEN)), torch.nan)
        whole[..., self.kept] = y - torch.tensor(self.bias).to(y)
        return self.station.locate(whole, t)


class StationsOfFile(Several):
    """All stations of a file as one model; component names include the station, such as `kiruna.range`.

    Args:
        file: path of the file, see `ahnn.measurements.station_file`.
        earth_angle: see `GroundStation`.
        mass: mass of the satellite in kg.
        only: names of the stations to use; None for all.

    Attributes:
        stations: stations by name.
        deviations: standard deviations of all components.
        bias_sd: standard deviations of their biases, 0 for no bias.

    Raises:
        UserError: no station, or an invalid or unknown one.
    """

    def __init__(
        self,
        file: str,
        earth_angle: float | list[list[float]] | DailyAxes | None = None,
        mass: float = 1.0,
        only: Sequence[str] | None = None,
    ) -> None:
        known = read_stations(file)
        self.stations = {
            name: BiasedStation(known[name], earth_angle, mass, f"{file}: {name}.")
            for name in known
            if only is None or name in only
        }
        if lacking := [name for name in only or () if name not in known]:
            message = f"{file}: expected stations {', '.join(only or ())}; received none named {lacking[0]!r}"
            raise UserError(message + nearest(lacking[0], tuple(known)))
        if not (models := [*self.stations.values()]):
            message = f"{file}: expected at least one station; received none"
            raise UserError(message)
        super().__init__(models)
        self.names = tuple(f"{key}.{name}" for key, one in self.stations.items() for name in one.names)
        self.file, self.mass = file, mass
        self.deviations = [sd for model in models for sd in model.deviations]
        self.bias_sd = [sd for model in models for sd in model.bias_sd]
