"""Ensemble Kalman filter: covariances are estimated from an ensemble propagated by the flow."""

from __future__ import annotations

from ahnn_plugins.enkf.ensemble_filter import EnsembleKalmanFilter
from ahnn_plugins.enkf.localisation import Localisation, gaspari_cohn

__all__ = ["EnsembleKalmanFilter", "Localisation", "gaspari_cohn"]
