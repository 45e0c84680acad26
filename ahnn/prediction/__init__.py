"""Predictions with learned dynamics: states with covariance and novelty."""

from __future__ import annotations

from ahnn.prediction.propagation import Prediction, predicted, together

__all__ = ["Prediction", "predicted", "together"]
