"""Measurements as readers find them, one after the other, and what becomes of them: one satellite's data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.table import Place, within
from ahnn.tracking.tracking_data import KINDS, Event, Kind, TrackingData

UNKNOWN = (math.nan, math.nan, math.nan)
"""Weather where nobody said."""
BOUNDS: dict[Kind, tuple[float, float]] = {
    "range": (1e-3, 1e10),
    "range_rate": (-1e3, 1e3),
    "azimuth": (-math.pi, 2 * math.pi),
    "elevation": (-math.pi / 2, math.pi / 2),
    "right_ascension": (-math.pi, 2 * math.pi),
    "declination": (-math.pi / 2, math.pi / 2),
}
"""Between which a measurement is one."""
ROUNDING = 1e-12
"""Of factors from degrees."""


def measured(kind: Kind, text: str, factor: float, place: Place, correction: float = 0.0) -> float:
    """Return a measurement in km, rad or km/s.

    Args:
        kind: of the measurement.
        text: the number in a file.
        factor: from its unit.
        place: where it stands.
        correction: added to the number.

    Raises:
        UserError: no number, or one that no measurement of this kind has.
    """
    value = factor * (within(text, place, -1e30, 1e30) + correction)
    low, high = BOUNDS[kind]
    if not low - ROUNDING * abs(low) <= value <= high + ROUNDING * abs(high):
        place.refuse(f"a number from {low / factor:.10g} to {high / factor:.10g}", repr(text))
    return value


@dataclass(frozen=True)
class TrackingReading:
    """One measurement, or two angles of one instant.

    Attributes:
        moment: picoseconds from 2000-01-01 in UTC with all leap seconds (`epochs.instant`).
        station: its name.
        values: in km, rad and km/s.
        row: number of the line.
        weather: pressure in hPa, temperature in K, relative humidity from 0 to 1.
        wavelength: in micrometres.
        deviations: standard deviations that the file states, in the units of the values.
    """

    moment: int
    station: str
    values: dict[Kind, float]
    row: int
    weather: tuple[float, float, float] = UNKNOWN
    wavelength: float = math.nan
    deviations: dict[Kind, float] = field(default_factory=dict)


def between(known: list[int], values: list[float], moments: list[int]) -> list[float]:
    """Return values at moments, linear between the known ones and outside as at the nearest.

    Args:
        known: moments of the values, in any order, at least one.
        values: at these.
        moments: at which they are wanted.
    """
    origin, order = known[0], np.argsort([float(one - known[0]) for one in known], kind="stable")
    times = np.array([(one - origin) / epochs.SECOND for one in known])[order]
    wanted = [(one - origin) / epochs.SECOND for one in moments]
    return np.interp(wanted, times, np.array(values)[order]).tolist()


def gathered(
    name: str, readings: list[TrackingReading], event: Event, remarks: tuple[str, ...] = ()
) -> TrackingData:
    """Return readings of one satellite, at least one, in the order of their times.

    Args:
        name: of the satellite.
        readings: in any order; time zero is that of the first.
        event: what their times tag.
        remarks: what the file says that is not used.
    """
    ranked = sorted(readings, key=lambda one: one.moment)
    epoch = ranked[0].moment
    stations = tuple(dict.fromkeys(one.station for one in ranked))
    return TrackingData(
        object=name,
        epoch=epoch,
        times=np.array([(one.moment - epoch) / epochs.SECOND for one in ranked]),
        values=np.array([[one.values.get(kind, math.nan) for kind in KINDS] for one in ranked]),
        stations=stations,
        station=np.array([stations.index(one.station) for one in ranked], dtype=np.int64),
        event=event,
        weather=np.array([one.weather for one in ranked]),
        wavelength=np.array([one.wavelength for one in ranked]),
        deviations=np.array([[one.deviations.get(kind, math.nan) for kind in KINDS] for one in ranked]),
        remarks=remarks,
    )
