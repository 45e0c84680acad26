"""Steppers: how an optimiser is asked for a step, by a gradient or by a least-squares problem.

An optimiser names its stepper in the class attribute `stepper`; one without takes gradients.
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
    """How one optimiser step is taken.

    Attributes:
        automatic: whether the trainer takes the step by the gradient of what `step` returns.
    """

    automatic: bool

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Raise UserError for settings of a training that cannot work with this stepper."""
        ...

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch before the step, a scalar."""
        ...


class FirstOrder:
    """The loss of the batch, whose gradient somebody else steps on."""

    automatic = True

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Anything can be trained by gradients."""

    def step(
        self, objective: Objective, loss: nn.Module, dynamics: Dynamics, batch: Any, optimizer: Any
    ) -> Tensor:
        """Return the loss of the batch, with its graph."""
        del optimizer
        value = loss(objective.residuals(dynamics, batch))
        weight = getattr(batch, "weight", 1)
        return value if weight == 1 else value * weight


class SecondOrder:
    """A step on part of the batch as a least-squares problem, checked on the rest."""

    automatic = False

    def check(self, trainer: Any, dynamics: Dynamics) -> None:
        """Refuse what only gradients can do, and what leaves least squares without their digits.

        Raises:
            UserError: names the setting and its remedy.
        """
        wide = next(dynamics.parameters()).dtype == torch.float64
        explicit = not isinstance(getattr(dynamics, "integrator", None), GaussLegendre4)
        clip, batches = trainer.gradient_clip_val or 0, trainer.accumulate_grad_batches
        for name, fits, expected, received in (
            ("data.precision", wide, "64, for the digits of least squares,", 32),
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
        del loss  # a sum of squares, without Huber's tails
        return optimizer.step(lambda: problems(objective, dynamics, batch))


def problems(
    objective: Objective, dynamics: Dynamics, batch: Any
) -> tuple[LeastSquaresProblem, LeastSquaresProblem | None]:
    """Return the problem to step on, and the one that checks the step, if part of the batch is held back."""
    step, check = objective.divided(batch)
    return objective.problem(dynamics, step), None if check is None else objective.problem(dynamics, check)


def stepper_of(optimizer: Optimizer) -> Stepper:
    """Return the stepper that an optimiser asks for."""
    return getattr(optimizer, "stepper", None) or FirstOrder()
