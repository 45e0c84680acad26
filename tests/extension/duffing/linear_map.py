"""A map: x(t + dt) - x(t) = A x for the sampling interval of the data alone, and its model."""

from typing import Any, final

import torch
from torch import Tensor

from ahnn.dynamics import StepMap, make_dynamics
from ahnn.dynamics.scaling import Kind
from ahnn.models import AbstractModel
from ahnn.types import TimeStep


@final
class LinearMap(StepMap):
    """`StepMap` stores the sampling interval of the training data as `own_step`, and scales the states."""

    assumes = "linear map"

    def __init__(self, dof: int, *, scaling: Kind) -> None:
        super().__init__(dof, scaling)
        self.matrix = torch.nn.Linear(2 * dof, 2 * dof)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D); raises UserError for another step."""
        self.require(dt)
        return self.matrix(self.seen(x))


@final
class LinearModel(AbstractModel):
    """Model without a network: its class does not take the argument."""

    def __init__(self, dof: int, *, scaling: Kind, window: int, loss: dict[str, Any]) -> None:
        super().__init__(make_dynamics("linear_map", dof=dof, scaling=scaling), dof, window, loss)
        self.save_hyperparameters()
