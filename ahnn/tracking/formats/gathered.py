"""Assembly of individual measurements into the tracking data of one satellite."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.table import Place, within
from ahnn.tracking.tracking_data import KINDS, Event, Kind, TrackingData

UNKNOWN = (math.nan, math.nan, math.nan)
"""Unknown weather."""
BOUNDS: dict[Kind, tuple[float, float]] = {
    "range": (1e-3, 1e10),
    "range_rate": (-1e3, 1e3),
    "azimuth": (-math.pi, 2 * math.pi),
    "elevation": (-math.pi / 2, math.pi / 2),
    "right_ascension": (-math.pi, 2 * math.pi),
    "declination": (-math.pi / 2, math.pi / 2),
}
"""Valid range of each kind of measurement."""
ROUNDING = 1e-12
"""Relative tolerance for rounding in conversions from degrees."""


def measured(kind: Kind, text: str, factor: float, place: Place, correction: float = 0.0) -> float:
    """Parse a measurement and convert it to km, rad or km/s.

    Args:
        kind: kind of the measurement.
        text: number in the file.
        factor: conversion factor of its unit.
        place: place in the file.
        correction: correction added to the number.

    Raises:
        UserError: an invalid number, or one outside the valid range of the kind.
    """
    value = factor * (within(text, place, -1e30, 1e30) + correction)
    low, high = BOUNDS[kind]
    if not low - ROUNDING * abs(low) <= value <= high + ROUNDING * abs(high):
        place.refuse(f"a number from {low / factor:.10g} to {high / factor:.10g}", repr(text))
    return value


@dataclass(frozen=True)
class TrackingReading:
    """Simultaneous measurements by one station.

    Attributes:
        moment: picoseconds since 2000-01-01 in UTC with all leap seconds (`epochs.instant`).
        station: station name.
        values: values in km, rad and km/s.
        row: line number.
        weather: pressure in hPa, temperature in K, relative humidity from 0 to 1.
        wavelength: wavelength in micrometres.
        deviations: standard deviations from the file, in the units of the values.
    """

    moment: int
    station: str
    values: dict[Kind, float]
    row: int
    weather: tuple[float, float, float] = UNKNOWN
    wavelength: float = math.nan
    deviations: dict[Kind, float] = field(default_factory=dict)


def between(known: list[int], values: list[float], moments: list[int]) -> list[float]:
    """Interpolate values linearly at moments; outside the known range the nearest value is used.

    Args:
        known: moments of the values, in any order, at least one.
        values: values at these moments.
        moments: moments of the result.
    """
    origin, order = known[0], np.argsort([float(one - known[0]) for one in known], kind="stable")
    times = np.array([(one - origin) / epochs.SECOND for one in known])[order]
    wanted = [(one - origin) / epochs.SECOND for one in moments]
    return np.interp(wanted, times, np.array(values)[order]).tolist()


def gathered(
    name: str, readings: list[TrackingReading], event: Event, remarks: tuple[str, ...] = ()
) -> TrackingData:
    """Build tracking data from one or more readings of a satellite, sorted by time.

    Args:
        name: name of the satellite.
        readings: readings in any order; the earliest sets time zero.
        event: event tagged by the times.
        remarks: remarks on unused content of the file.
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
        rows=np.array([one.row for one in ranked], dtype=np.int64),
    )
