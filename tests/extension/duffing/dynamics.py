"""Dynamics: m d^2 q / dt^2 = f(q) with a network for f, which need not have a potential."""

from typing import Any, final

import torch
from torch import Tensor, nn

from ahnn.dynamics import Dynamics
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.integrators import make_integrator
from ahnn.statistics import Statistics
from ahnn.types import TimeStep


class Force(nn.Module):
    """The field (p / m, f(q)); `velocity` and `force` let symplectic compositions follow it."""

    size: Tensor

    def __init__(self, dof: int, inertia: float, scaling: Kind, network: dict[str, Any]) -> None:
        super().__init__()
        self.inertia, self.positions = inertia, Cartesian(dof, scaling, 0)
        self.network = make_network(dof, dof, network)
        self.register_buffer("size", torch.ones(dof))

    def velocity(self, p: Tensor) -> Tensor:
        """Return dq/dt, shape (..., n)."""
        return p / self.inertia

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt, shape (..., n)."""
        return self.size * self.network(self.positions(q))

    def forward(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.velocity(p), self.force(q)), dim=-1)


@final
class Newton(Dynamics):
    """Newton's second law; its arguments are plain values, which are stored beside the weights."""

    assumes = "kinetic energy known, any force f(q)"

    def __init__(
        self, dof: int, *, inertia: float, scaling: Kind, network: dict[str, Any], integrator: dict[str, Any]
    ) -> None:
        super().__init__()
        self.field = Force(dof, inertia, scaling, network)
        self.integrator = make_integrator(**integrator)
        self.integrator.require(self.field)

    def fit(self, statistics: Statistics) -> None:
        """Set the scaling and the unit of the force from the training split."""
        self.field.positions.fit(statistics)
        self.field.size.copy_(statistics.rate.chunk(2)[1])

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D)."""
        return self.integrator.increment(self.field, x, dt)
