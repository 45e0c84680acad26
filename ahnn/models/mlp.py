"""MLP: a network that maps a state to the next one."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor, nn

from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind, Statistics
from ahnn.errors import UserError
from ahnn.models.base import AbstractDynamics
from ahnn.types import TimeStep


class NextState(nn.Module):
    """Increment of the state over the sampling interval.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        residual: True learns the increment in units of its rms; False learns the next state itself.
        network: width, depth, activation.
    """

    rms: Tensor

    def __init__(self, dof: int, scaling: Kind, residual: bool, network: dict[str, Any]) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.network = make_network(2 * dof, 2 * dof, network)
        self.residual = residual
        self.register_buffer("rms", torch.ones(2 * dof))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and the rms increment from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.rms.copy_(statistics.increment)

    def forward(self, x: Tensor) -> Tensor:
        """Return x(t + dt) - x(t), shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        output = self.network(torch.cat((self.positions(q), self.momenta(p)), dim=-1))
        if self.residual:
            return self.rms * output
        next_q, next_p = output.chunk(2, dim=-1)
        return torch.cat((self.positions.affine.inverse(next_q), self.momenta.affine.inverse(next_p)), -1) - x


@final
class MLP(AbstractDynamics):
    """The paper's first baseline: no field, no integrator, one fixed time step.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        residual: learn the increment instead of the next state.
        network: width, depth, activation.
        window: W, steps of the recursive predictions in the loss.
        loss: options of `Loss`; a map has no field, so `derivative` must be 0.
    """

    def __init__(
        self,
        dof: int,
        *,
        scaling: Kind,
        residual: bool,
        network: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        super().__init__(NextState(dof, scaling, residual, network), dof, window, loss)
        self.save_hyperparameters()
        if self.loss.derivative:
            message = (
                f"model mlp: a map has no field; expected loss.derivative=0, received {self.loss.derivative}"
            )
            raise UserError(message)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the predicted increment, shape (B, D).

        Raises:
            UserError: dt is not the sampling interval of the training data.
        """
        if isinstance(dt, Tensor) or abs(dt - float(self.dt)) > 1e-6 * dt:
            message = (
                f"model mlp: expected the time step it was trained with, {float(self.dt)}; received {dt}. "
                "A map has no time axis: use node, hnn or ahnn for other steps."
            )
            raise UserError(message)
        return self.learner(x)
