"""What ground stations measured of one satellite, in one representation for all files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["range", "azimuth", "elevation", "range_rate", "right_ascension", "declination"]
"""What is measured: km, rad or km/s; a range is half of the light's way there and back, times c."""
KINDS: tuple[Kind, ...] = ("range", "azimuth", "elevation", "range_rate", "right_ascension", "declination")
Event = Literal["receive", "transmit", "bounce"]
"""What happened at the time of a measurement: light arrived at the station, left it, or met the satellite."""


@dataclass(frozen=True, eq=False)
class TrackingData:
    """Measurements of one satellite by several stations, in the order of their times.

    Attributes:
        object: name of the satellite, empty where the file says none.
        epoch: of time zero, picoseconds from 2000-01-01 in UTC with all leap seconds, as
            `ahnn.data.files.epochs.instant` counts them.
        times: (N,) SI seconds after the epoch, not decreasing.
        values: (N, 6) in the order of `KINDS`, km, rad and km/s; NaN of what was not measured.
        stations: their names.
        station: (N,) place of each measurement's station among them.
        event: what the times tag.
        weather: (N, 3) pressure in hPa, temperature in K and relative humidity from 0 to 1 at the station;
            NaN where unknown.
        wavelength: (N,) of laser light in micrometres; NaN of radio.
        deviations: (N, 6) standard deviations that the file states; NaN where it states none.
        remarks: what the file says that is not used, in words.
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
        """What is measured at least once."""
        return tuple(k for k, column in zip(KINDS, self.values.T, strict=True) if np.isfinite(column).any())
