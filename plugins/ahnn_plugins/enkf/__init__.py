"""Ensemble Kalman filter: the covariance is that of an ensemble, which the flow carries member by member."""

from __future__ import annotations

from ahnn_plugins.enkf.ensemble_filter import EnsembleKalmanFilter
from ahnn_plugins.enkf.localisation import Localisation, gaspari_cohn

__all__ = ["EnsembleKalmanFilter", "Localisation", "gaspari_cohn"]
