"""Evaluation of estimators on unseen trajectories: settings, process noise fits, rows, figures."""

from __future__ import annotations

from ahnn.evaluation.estimators.plugin import Bias, EstimatorEvaluation

__all__ = ["Bias", "EstimatorEvaluation"]
