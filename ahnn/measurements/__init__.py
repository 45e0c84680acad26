"""Measurement models, their fields of view, and measurement schedules.

A model maps states to measurements and defines their differences. It is any object with the members of
`Measurement`: a new one needs a class and a YAML file that names it.
"""

from __future__ import annotations

from ahnn.measurements.angles import continuous, nearest, periods, residual, wrap
from ahnn.measurements.base import Locating, Measurement, Sighted, Sloped, Time, observe
from ahnn.measurements.biases import Biases
from ahnn.measurements.daily_axes import DailyAxes
from ahnn.measurements.derived import DerivedMeasurement
from ahnn.measurements.gnss import GnssRange
from ahnn.measurements.ground_station import GroundStation
from ahnn.measurements.noise import noise_deviations
from ahnn.measurements.noise_estimate import NoiseEstimate, UnknownNoise
from ahnn.measurements.observations import Observations
from ahnn.measurements.readings import Position, State, reading
from ahnn.measurements.schedule import Schedule, every, schedule
from ahnn.measurements.segment import Instrument, Segment
from ahnn.measurements.several import Several
from ahnn.measurements.station_file import StationsOfFile

__all__ = [
    "Biases",
    "DailyAxes",
    "DerivedMeasurement",
    "GnssRange",
    "GroundStation",
    "Instrument",
    "Locating",
    "Measurement",
    "NoiseEstimate",
    "Observations",
    "Position",
    "Schedule",
    "Segment",
    "Several",
    "Sighted",
    "Sloped",
    "State",
    "StationsOfFile",
    "Time",
    "UnknownNoise",
    "continuous",
    "every",
    "nearest",
    "noise_deviations",
    "observe",
    "periods",
    "reading",
    "residual",
    "schedule",
    "wrap",
]
