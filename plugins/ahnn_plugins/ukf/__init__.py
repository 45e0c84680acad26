"""Unscented Kalman filter: batched over trajectories, in square-root form, honest about its uncertainty.

A pure kernel over NamedTuples in float64: any function `flow(x, dt)` is the process model, NaN marks what was
not measured, one bad member gets a status and never touches another, every repair is counted. A smoother
and measurement models come with it. The kernel needs nothing of a training run and can be used alone.
"""

from __future__ import annotations

from ahnn.estimation.belief import Belief, Gate, Status
from ahnn.estimation.covariances import initial_belief
from ahnn.measurements.base import Measurement, Position, State, wrap
from ahnn.measurements.schedule import Schedule, every, schedule
from ahnn.measurements.stations import GnssRange, GroundStation
from ahnn_plugins.ukf.filter import unscented_filter
from ahnn_plugins.ukf.smoother import unscented_smoother
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.standard import STANDARD
from ahnn_plugins.ukf.types import FilterResult, Form, SmootherResult, UnscentedParameters

__all__ = [
    "SQUARE_ROOT",
    "STANDARD",
    "Belief",
    "FilterResult",
    "Form",
    "Gate",
    "GnssRange",
    "GroundStation",
    "Measurement",
    "Position",
    "Schedule",
    "SmootherResult",
    "State",
    "Status",
    "UnscentedParameters",
    "every",
    "initial_belief",
    "schedule",
    "unscented_filter",
    "unscented_smoother",
    "wrap",
]
