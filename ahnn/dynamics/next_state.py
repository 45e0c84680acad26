"""Dynamics without a field: a network from one state to the next."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor

from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import TimeStep


@final
class NextState(Dynamics):
    """A network that maps a state to the next one: no field, no integrator, one fixed time step.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        residual: True learns the increment in units of its rms; False learns the next state itself.
        network: width, depth, activation.
    """

    assumes = "no Hamiltonian"
    rms: Tensor
    dt: Tensor

    def __init__(self, dof: int, *, scaling: Kind, residual: bool, network: dict[str, Any]) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.network = make_network(2 * dof, 2 * dof, network)
        self.residual = residual
        self.register_buffer("rms", torch.ones(2 * dof))
        self.register_buffer("dt", torch.zeros((), dtype=torch.float64))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings, the rms increment and the time step from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.rms.copy_(statistics.increment)
        self.dt.fill_(statistics.dt)

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)

    @property
    def own_step(self) -> float:
        """The sampling interval of the training data."""
        return float(self.dt)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the predicted increment, shape (B, D).

        Raises:
            UserError: dt is not the sampling interval of the training data.
        """
        require_step(self.dt, dt)
        output = self.network(self.seen(x))
        if self.residual:
            return self.rms * output
        next_q, next_p = output.chunk(2, dim=-1)
        return torch.cat((self.positions.affine.inverse(next_q), self.momenta.affine.inverse(next_p)), -1) - x


def require_step(known: Tensor, dt: TimeStep) -> None:
    """Refuse steps that are not that of the training of a map, which has no time axis; raises UserError."""
    if torch.compiler.is_exporting():  # a graph has the step that it was made for
        return
    step = float(known)
    off = float((dt - step).abs().max()) if isinstance(dt, Tensor) else abs(dt - step)
    if not off <= 1e-6 * step:
        received = "steps that differ" if isinstance(dt, Tensor) else f"{dt:.6g}"
        message = (
            f"model: expected the step of its training, {step:.6g}; received {received}. A map has no time "
            "axis: use node, hnn or ahnn for other steps"
        )
        raise UserError(message)
