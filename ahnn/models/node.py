"""NODE: a neural vector field through an integrator."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor, nn

from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind, Statistics
from ahnn.integrators import make_integrator
from ahnn.models.base import AbstractDynamics
from ahnn.types import TimeStep


class NeuralField(nn.Module):
    """dx/dt as a network, in units of the typical rate of each component.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        network: width, depth, activation.
    """

    rate: Tensor

    def __init__(self, dof: int, scaling: Kind, network: dict[str, Any]) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.network = make_network(2 * dof, 2 * dof, network)
        self.register_buffer("rate", torch.ones(2 * dof))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and rates from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.rate.copy_(statistics.rate)

    def forward(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return self.rate * self.network(torch.cat((self.positions(q), self.momenta(p)), dim=-1))


@final
class NODE(AbstractDynamics):
    """Neural ordinary differential equation (Chen et al. 2018), differentiated through the steps.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.
        window: W, steps of the recursive predictions in the loss.
        loss: options of `Loss`.
    """

    def __init__(
        self,
        dof: int,
        *,
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        super().__init__(NeuralField(dof, scaling, network), dof, window, loss)
        self.save_hyperparameters()
        self.integrator = make_integrator(**integrator)
        self.integrator.require(self.learner)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the integrator's increment along the neural field, shape (B, D)."""
        return self.integrator.increment(self.learner, x, dt)
