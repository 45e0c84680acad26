"""Training of dynamics: objectives, steppers, optimisers, schedules, and callbacks."""

from __future__ import annotations

from ahnn.training.curriculum import Curriculum, SegmentOptions, make_curriculum
from ahnn.training.hyperbolic import ExpHyperbolicLR
from ahnn.training.least_squares import (
    LeastSquares,
    LeastSquaresProblem,
    pointwise_problem,
    recursive_problem,
)
from ahnn.training.levenberg_marquardt import LevenbergMarquardt
from ahnn.training.loss import Loss, LossOptions
from ahnn.training.objectives import Derivative, Objective, Recursive
from ahnn.training.shooting import Shooting
from ahnn.training.steppers import FirstOrder, SecondOrder, Stepper, stepper_of

__all__ = [
    "Curriculum",
    "Derivative",
    "ExpHyperbolicLR",
    "FirstOrder",
    "LeastSquares",
    "LeastSquaresProblem",
    "LevenbergMarquardt",
    "Loss",
    "LossOptions",
    "Objective",
    "Recursive",
    "SecondOrder",
    "SegmentOptions",
    "Shooting",
    "Stepper",
    "make_curriculum",
    "pointwise_problem",
    "recursive_problem",
    "stepper_of",
]
