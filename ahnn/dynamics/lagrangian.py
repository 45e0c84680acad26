"""Lagrangian neural networks, implemented from Cranmer, Greydanus, Hoyer, Battaglia, Spergel & Ho (2020).

    d/dt dL/dv = dL/dq   gives   a = (d2L/dv2)^-1 (dL/dq - d2L/dvdq v)

with L = m v^2 / 2 + E N(q, v). The network is added to the kinetic energy, so that d2L/dv2 is invertible at
the start of training.
"""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor, nn
from torch.func import vjp

from ahnn.arguments import Positive
from ahnn.dynamics.fields import IntegratedField
from ahnn.dynamics.gradients import plain_gradient
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics


class LagrangianField(nn.Module):
    """Vector field dx/dt of states [q, p], p = m v, from a Lagrangian network.

    Args:
        dof: degrees of freedom n.
        inertia: factor m of p = m dq/dt, common or per coordinate.
        scaling: minmax, block or none.
        network: width, depth, activation.
    """

    inertia: Tensor
    unit: Tensor

    def __init__(
        self, dof: int, inertia: float | list[float], scaling: Kind, network: dict[str, Any]
    ) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.network = make_network(2 * dof, 1, network)
        self.register_buffer("inertia", torch.as_tensor(inertia, dtype=torch.float32).expand(dof).clone())
        self.register_buffer("unit", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings, and the unit of energy from forces and ranges of the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        forces = statistics.rate[self.momenta.part]
        self.unit.copy_((forces * self.positions.affine.scale).max())

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)

    def forward(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D)."""
        p = x.chunk(2, dim=-1)[1]
        v, dof = p / self.inertia, p.shape[-1]
        per_v = self.momenta.affine.scale / self.inertia
        scale = torch.cat((self.positions.affine.scale, per_v))

        def slope(z: Tensor) -> Tensor:
            return plain_gradient(z, self.network.layers(), self.network.activation)

        value, back = vjp(slope, self.seen(x))[:2]
        rows = [back(unit.expand_as(value))[0] for unit in torch.eye(2 * dof).to(value)]
        first = self.unit * value / scale
        second = self.unit * torch.stack(rows, dim=-2) / scale / scale.unsqueeze(-1)
        mass = second[..., dof:, dof:] + torch.diag_embed(self.inertia.to(value).expand_as(v))
        turned = (second[..., dof:, :dof] @ v.unsqueeze(-1)).squeeze(-1)
        acceleration = torch.linalg.solve(mass, first[..., :dof] - turned)
        return torch.cat((v, self.inertia * acceleration), dim=-1)


@final
class LagrangianDynamics(IntegratedField):
    """Euler-Lagrange equations of a learned Lagrangian.

    Args:
        dof: degrees of freedom n.
        inertia: factor m of p = m dq/dt, common or per coordinate.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.

    Raises:
        UserError: wrong number of masses.
    """

    assumes = "a Lagrangian of q and v"
    anchored = False

    def __init__(
        self,
        dof: int,
        *,
        inertia: Positive | list[Positive],
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
    ) -> None:
        if isinstance(inertia, list) and len(inertia) != dof:
            message = f"inertia: expected one mass, or {dof}; received {inertia}"
            raise UserError(message)
        super().__init__(LagrangianField(dof, inertia, scaling, network), integrator)
