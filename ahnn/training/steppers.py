"""Steppers: optimiser steps from a gradient or from a least-squares problem.

An optimiser names its stepper in the class attribute `stepper`; the default uses gradients.
"""

from __future__ import annotations

from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4
from ahnn.training.least_squares import LeastSquaresProblem
from ahnn.training.objectives import Objective


class Stepper(Protocol):
    """Protocol of an optimiser step.

    Attributes:
        automatic: whether `step` only returns a loss, and the trainer takes the gradient step.
    """

    automatic: bool

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Raise UserError for training settings incompatible with this stepper."""
        ...

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch before the step, a scalar."""
        ...


class FirstOrder:
    """Gradient step: returns the loss of the batch, and the trainer takes the step."""

    automatic = True

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Accept all settings: gradients support any training."""

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch, with its graph."""
        value = loss(objective.residuals(dynamics, batch))
        weight = getattr(batch, "weight", 1)
        return value if weight == 1 else value * weight


class SecondOrder:
    """Second-order step on part of the batch as a least-squares problem, checked on the rest."""

    automatic = False

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Reject settings that require gradients, or a precision too low for least squares.

        Raises:
            UserError: such a setting; the message names it and a remedy.
        """
        wide = next(dynamics.parameters()).dtype == torch.float64
        explicit = not isinstance(getattr(dynamics, "integrator", None), GaussLegendre4)
        clip, batches = trainer.gradient_clip_val or 0, trainer.accumulate_grad_batches
        for name, fits, expected, received in (
            ("data.precision", wide, "64, for the precision of least squares,", 32),
            ("integrator", explicit, "an explicit method, to differentiate through,", "gl4"),
            ("trainer.devices", trainer.world_size == 1, "one", trainer.world_size),
            ("trainer.gradient_clip_val", clip == 0, "none, since it takes its own steps,", clip),
            ("trainer.accumulate_grad_batches", batches == 1, "1, since it takes its own steps,", batches),
        ):
            if not fits:
                message = (
                    f"{name}: expected {expected} with levenberg_marquardt; received {received}. "
                    "Change it, or choose recipe=first_order"
                )
                raise UserError(message)

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Take the step and return the mean squared residual before it."""
        # The loss is the sum of squares, without Huber's linear tails.
        return optimizer.step(lambda: problems(objective, dynamics, batch))


def problems(
    objective: Objective, dynamics: Dynamics, batch: Any
) -> tuple[LeastSquaresProblem, LeastSquaresProblem | None]:
    """Return the problem of the step, and the one that checks it, if part of the batch is held out."""
    step, check = objective.divided(batch)
    return objective.problem(dynamics, step), None if check is None else objective.problem(dynamics, check)


def stepper_of(optimizer: Optimizer) -> Stepper:
    """Return the stepper of an optimiser."""
    return getattr(optimizer, "stepper", None) or FirstOrder()
