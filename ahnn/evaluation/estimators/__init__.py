"""Estimators judged on unseen trajectories: settings, fits of process noise, rows, figures."""

from __future__ import annotations

from ahnn.evaluation.estimators.plugin import Bias, EstimatorEvaluation

__all__ = ["Bias", "EstimatorEvaluation"]
