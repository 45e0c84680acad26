"""Estimators judged on unseen trajectories: settings, fits of process noise, rows, figures."""

from __future__ import annotations

from ahnn.evaluation.estimators.plugin import EstimatorEvaluation

__all__ = ["EstimatorEvaluation"]
