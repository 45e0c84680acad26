"""Base class of discrete-time dynamics: scaled inputs and the fixed time step of the training data."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.scaling import Kind
from ahnn.statistics import Statistics


class StepMap(Dynamics):
    """Map from one sample to the next.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
    """

    dt: Tensor

    def __init__(self, dof: int, scaling: Kind) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.register_buffer("dt", torch.zeros((), dtype=torch.float64))

    @property
    def own_step(self) -> float:
        """Sampling interval of the training data."""
        return float(self.dt)

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and the time step from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.dt.fill_(statistics.dt)

    def seen(self, x: Tensor) -> Tensor:
        """Return scaled states, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)
