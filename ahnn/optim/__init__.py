"""Optimisation beyond what torch has: the paper's learning-rate schedule, and Levenberg-Marquardt."""

from __future__ import annotations

from ahnn.optim.hyperbolic import ExpHyperbolicLR
from ahnn.optim.least_squares import LeastSquares, pointwise_problem, recursive_problem
from ahnn.optim.levenberg_marquardt import LevenbergMarquardt

__all__ = ["ExpHyperbolicLR", "LeastSquares", "LevenbergMarquardt", "pointwise_problem", "recursive_problem"]
