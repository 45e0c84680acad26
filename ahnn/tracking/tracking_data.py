"""Tracking data of one satellite, in a common representation for all formats."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["range", "azimuth", "elevation", "range_rate", "right_ascension", "declination"]
"""Kinds of measurements: km, rad or km/s; a range is half the two-way light time, times c."""
KINDS: tuple[Kind, ...] = ("range", "azimuth", "elevation", "range_rate", "right_ascension", "declination")
Event = Literal["receive", "transmit", "bounce"]
"""Events tagged by measurement times: reception or transmission at the station, bounce at the satellite."""


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
        wavelength: (N,) of laser light in micrometres; NaN for radio.
        deviations: (N, 6) standard deviations from the file, or NaN.
        remarks: remarks on unused content of the file.
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

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds measured at least once."""
        return tuple(k for k, column in zip(KINDS, self.values.T, strict=True) if np.isfinite(column).any())
