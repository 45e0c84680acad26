"""Unscented Kalman filter: batched over trajectories, in square-root form, with consistent uncertainty.

The kernel consists of pure functions of NamedTuples in float64: any function `flow(x, dt)` can be the process
model, NaN marks missing components, a failed member gets a status and never affects other members, and every
repair is counted. The filter processes one prediction or measurement at a time (`UnscentedKalmanFilter`), or
a batch of them (`unscented_filter`) with a smoother. It is independent of training runs.
"""

from __future__ import annotations

from ahnn.estimation.batch_least_squares import BatchResult, batch_least_squares
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.likelihood import Learned, learned_noise
from ahnn.estimation.online import online_process
from ahnn.estimation.parameter_error import ParameterError
from ahnn.estimation.results import FilterResult, SmootherResult
from ahnn_plugins.ukf.gauss_hermite import GaussHermiteFilter
from ahnn_plugins.ukf.iterated import Iterated, iterated_smoother
from ahnn_plugins.ukf.parameters import Form, UnscentedParameters
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.standard import STANDARD
from ahnn_plugins.ukf.unscented_filter import UnscentedKalmanFilter, unscented_filter
from ahnn_plugins.ukf.unscented_smoother import unscented_smoother

__all__ = [
    "SQUARE_ROOT",
    "STANDARD",
    "BatchResult",
    "FilterResult",
    "ForceError",
    "Form",
    "GaussHermiteFilter",
    "Iterated",
    "Learned",
    "ParameterError",
    "SmootherResult",
    "UnscentedKalmanFilter",
    "UnscentedParameters",
    "batch_least_squares",
    "iterated_smoother",
    "learned_noise",
    "online_process",
    "unscented_filter",
    "unscented_smoother",
]
