"""Optimisation beyond what torch has: the learning-rate schedule of the paper."""

from __future__ import annotations

from ahnn.optim.hyperbolic import ExpHyperbolicLR

__all__ = ["ExpHyperbolicLR"]
