"""Tracking data of one satellite, in a common representation for all formats."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import epochs
from ahnn.errors import UserError
from ahnn.measurements.ground_station import Event

Kind = Literal["range", "azimuth", "elevation", "range_rate", "right_ascension", "declination"]
"""Kinds of measurements: km, rad or km/s; a range is c times half the two-way light time."""
KINDS: tuple[Kind, ...] = ("range", "azimuth", "elevation", "range_rate", "right_ascension", "declination")
EVENTS: dict[Event, str] = {"receive": "reception", "transmit": "transmission", "bounce": "reflection"}
"""Events tagged by times, in words."""
UNITS = dict.fromkeys(KINDS, "rad") | {"range": "km", "range_rate": "km/s"}


@dataclass(frozen=True, eq=False)
class TrackingData:
    """Measurements of one satellite by several stations, in order of time.

    Attributes:
        object: name of the satellite, empty if unspecified.
        epoch: epoch of time zero, picoseconds since 2000-01-01 in UTC with all leap seconds
            (`ahnn.data.files.epochs.instant`).
        times: (N,) SI seconds after the epoch, not decreasing.
        values: (N, 6) in the order of `KINDS`, km, rad and km/s; NaN where missing.
        stations: station names.
        station: (N,) station index of each measurement.
        event: event tagged by the times.
        weather: (N, 3) pressure in hPa, temperature in K and relative humidity from 0 to 1 at the station;
            NaN where unknown.
        wavelength: (N,) wavelength of laser light in micrometres; NaN for radio.
        deviations: (N, 6) standard deviations from the file, or NaN.
        remarks: remarks on unused content of the file.
        rows: (N,) line numbers in the file; None if the measurements are not those of one file.
    """

    object: str
    epoch: int
    times: NDArray[np.float64]
    values: NDArray[np.float64]
    stations: tuple[str, ...]
    station: NDArray[np.int64]
    event: Event
    weather: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    deviations: NDArray[np.float64]
    remarks: tuple[str, ...] = field(default=())
    rows: NDArray[np.int64] | None = None

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds measured at least once."""
        return tuple(k for k, column in zip(KINDS, self.values.T, strict=True) if np.isfinite(column).any())


def joined(one: TrackingData, other: TrackingData) -> tuple[TrackingData, NDArray[np.bool_]]:
    """Merge two sets of measurements of one satellite; time zero is that of the first set.

    Returns:
        The measurements, and the mask of those from the first set, (N,).

    Raises:
        UserError: the times of the two sets tag different events.
    """
    if one.event != other.event:
        message = f"measurements: expected times of {one.event}, as before; received times of {other.event}"
        raise UserError(message)
    times = np.concatenate((one.times, other.times + (other.epoch - one.epoch) / epochs.SECOND))
    order = np.argsort(times, kind="stable")
    stations = tuple(dict.fromkeys((*one.stations, *other.stations)))
    place = np.array([stations.index(name) for part in (one, other) for name in part.stations])
    station = place[np.concatenate((one.station, other.station + len(one.stations)))]
    both = {
        name: np.concatenate((getattr(one, name), getattr(other, name)))[order]
        for name in ("values", "weather", "wavelength", "deviations")
    }
    whole = replace(one, times=times[order], stations=stations, station=station[order], rows=None, **both)
    return whole, order < len(one.times)
