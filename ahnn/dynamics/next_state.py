"""Discrete-time dynamics: a network that maps one state to the next."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor

from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.dynamics.step_map import StepMap
from ahnn.statistics import Statistics
from ahnn.types import TimeStep


@final
class NextState(StepMap):
    """Network that maps a state to the next one, with a fixed time step and no vector field.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        residual: True to learn the increment in units of its rms, False to learn the next state.
        network: width, depth, activation.
    """

    assumes = "no Hamiltonian"
    anchored = False
    rms: Tensor

    def __init__(self, dof: int, *, scaling: Kind, residual: bool, network: dict[str, Any]) -> None:
        super().__init__(dof, scaling)
        self.network = make_network(2 * dof, 2 * dof, network)
        self.residual = residual
        self.register_buffer("rms", torch.ones(2 * dof))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings, the rms increment and the time step from the training split."""
        super().fit(statistics)
        self.rms.copy_(statistics.increment)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the predicted increment, shape (B, D).

        Raises:
            UserError: dt is not the sampling interval of the training data.
        """
        self.require(dt)
        output = self.network(self.seen(x))
        if self.residual:
            return self.rms * output
        next_q, next_p = output.chunk(2, dim=-1)
        return torch.cat((self.positions.affine.inverse(next_q), self.momenta.affine.inverse(next_p)), -1) - x
