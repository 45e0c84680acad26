"""Force given by a network of selected positions, velocities, time and controls."""

from __future__ import annotations

from typing import Any, Literal, final

import torch
from torch import Tensor

from ahnn.arguments import checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.layered import silence
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Affine
from ahnn.errors import UserError
from ahnn.statistics import Statistics

Seen = Literal["q", "v", "t", "u"]


@final
@checked
class NetworkForce(Force):
    """Network for f(q, v, t, u), in units of the typical force; it imposes no conservation law.

    Args:
        dof: degrees of freedom n.
        controls: number m of controls.
        sees: network inputs among q, v, t and u.
        network: width, depth, activation.

    Raises:
        UserError: no inputs, or repeated ones.
    """

    unit: Tensor

    def __init__(
        self,
        dof: int,
        controls: int,
        *,
        sees: list[Seen],
        network: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        sizes = {"t": 1, "u": controls, "q": dof, "v": dof}
        if not sees or len({*sees}) < len(sees):
            message = (
                "network force: expected `sees` to name at least one of q, v, t and u, none of them twice; "
                f"received {sees}"
            )
            raise UserError(message)
        self.sees = [name for name in sizes if name in sees]
        self.timed, self.controlled = "t" in sees, "u" in sees  # pyright: ignore[reportAttributeAccessIssue]
        self.assumes = f"any force of {', '.join(self.sees)}"
        inputs = sum(sizes[name] for name in self.sees)
        self.scaling = Affine("minmax", inputs)
        self.network = make_network(inputs, dof, network or {"width": 32, "depth": 2, "activation": "tanh"})
        self.register_buffer("unit", torch.ones(dof))

    def fit(self, statistics: Statistics) -> None:
        """Set scaling and unit from the training split."""
        clock = statistics.clock
        parts = {"t": clock[:, :1], "u": clock[:, 1:], "q": statistics.positions, "v": statistics.velocities}
        seen = torch.cat([parts[name] for name in self.sees], dim=-1)
        self.scaling.fit(seen.amin(0), seen.amax(0))
        self.unit.copy_(statistics.forces.square().mean(0).sqrt())

    def silence(self) -> None:
        """Set the force to zero."""
        silence(self)

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., n)."""
        seen = torch.cat([getattr(at, name) for name in self.sees], dim=-1)
        return self.unit * self.network(self.scaling(seen))
