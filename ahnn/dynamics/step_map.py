"""Base class of discrete-time dynamics: scaled inputs and the fixed time step of the training."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import TimeStep


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

    def require(self, dt: TimeStep) -> None:
        """Raise UserError for a step other than the training step."""
        if not torch.compiler.is_exporting():  # a graph is specific to its step
            require_step(self.own_step, dt)

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and the time step from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.dt.fill_(statistics.dt)

    def seen(self, x: Tensor) -> Tensor:
        """Return scaled states, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)


def require_step(step: float, dt: TimeStep) -> None:
    """Raise UserError for steps other than the training step of a map, which is not continuous in time."""
    off = float((dt - step).abs().max()) if isinstance(dt, Tensor) else abs(dt - step)
    if not off <= 1e-6 * step:
        received = "steps that differ" if isinstance(dt, Tensor) else f"{dt:.6g}"
        message = (
            f"model: expected the step of its training, {step:.6g}; received {received}. A map has no time "
            "axis: use node, hnn or ahnn for other steps"
        )
        raise UserError(message)
