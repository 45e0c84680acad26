"""A learned force about an axis: whatever the motion of a body about an oblate one has besides."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor

from ahnn.arguments import NonNegative, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Affine
from ahnn.errors import UserError
from ahnn.statistics import Statistics


@final
@checked
class AxialNetwork(Force):
    """f = F (R / r)^k (a q / r + b v / |v| + c z), with a network for a, b and c.

    It sees log r, the sine of the latitude, and the velocity along the radius and across it: turned about
    the polar axis z, a motion is the same motion. Any such force that does not leave the plane of q, v and z
    is one of these; it conserves nothing.

    Args:
        dof: 3, with the polar axis last.
        controls: not used.
        falloff: k.
        network: width, depth, activation.

    Raises:
        UserError: other than three coordinates.
    """

    unit: Tensor
    nearest: Tensor
    assumes = "any force about the polar axis"

    def __init__(
        self, dof: int, controls: int = 0, *, falloff: NonNegative, network: dict[str, Any] | None = None
    ) -> None:
        super().__init__()
        del controls
        if dof != 3:
            message = f"axial: expected three coordinates; received {dof}"
            raise UserError(message)
        self.falloff = falloff
        self.scaling = Affine("minmax", 4)
        self.network = make_network(4, 3, network or {"width": 24, "depth": 2, "activation": "tanh"})
        self.register_buffer("unit", torch.ones(()))
        self.register_buffer("nearest", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set scaling and unit from what known forces leave of the training split."""
        seen = features(statistics.positions, statistics.velocities)
        self.scaling.fit(seen.amin(0), seen.amax(0))
        self.nearest.copy_(statistics.radius[0])
        weights = (self.nearest / statistics.positions.norm(dim=-1, keepdim=True)) ** self.falloff
        self.unit.copy_((statistics.forces.square().mean() / weights.square().mean()).sqrt())

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., 3)."""
        r, speed = at.q.norm(dim=-1, keepdim=True), at.v.norm(dim=-1, keepdim=True)
        a, b, c = self.network(self.scaling(features(at.q, at.v))).split(1, dim=-1)
        polar = torch.tensor([0.0, 0.0, 1.0]).to(at.q)
        found = a * at.q / r + b * at.v / speed + c * polar
        return self.unit * (self.nearest / r) ** self.falloff * found


def features(q: Tensor, v: Tensor) -> Tensor:
    """Return log r, sin(latitude), and the velocity along the radius and across it, shape (..., 4)."""
    r = q.norm(dim=-1, keepdim=True)
    along = (q * v).sum(-1, keepdim=True) / r
    across = torch.linalg.cross(q, v).norm(dim=-1, keepdim=True) / r
    return torch.cat((r.log(), q[..., 2:] / r, along, across), dim=-1)
