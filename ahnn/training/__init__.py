"""How dynamics learn: objectives, steppers and optimisers, schedules, and the callbacks of a training."""

from __future__ import annotations

from ahnn.training.hyperbolic import ExpHyperbolicLR
from ahnn.training.least_squares import LeastSquares, pointwise_problem, recursive_problem
from ahnn.training.levenberg_marquardt import LevenbergMarquardt
from ahnn.training.loss import Loss, LossOptions
from ahnn.training.objectives import Curriculum, Derivative, Objective, Recursive, make_curriculum
from ahnn.training.steppers import FirstOrder, SecondOrder, Stepper, stepper_of

__all__ = [
    "Curriculum",
    "Derivative",
    "ExpHyperbolicLR",
    "FirstOrder",
    "LeastSquares",
    "LevenbergMarquardt",
    "Loss",
    "LossOptions",
    "Objective",
    "Recursive",
    "SecondOrder",
    "Stepper",
    "make_curriculum",
    "pointwise_problem",
    "recursive_problem",
    "stepper_of",
]
