"""Optimisation beyond what torch has: the paper's learning-rate schedule, and Levenberg-Marquardt."""

from __future__ import annotations

from ahnn.training.hyperbolic import ExpHyperbolicLR
from ahnn.training.least_squares import LeastSquares, pointwise_problem, recursive_problem
from ahnn.training.levenberg_marquardt import LevenbergMarquardt

__all__ = ["ExpHyperbolicLR", "LeastSquares", "LevenbergMarquardt", "pointwise_problem", "recursive_problem"]
