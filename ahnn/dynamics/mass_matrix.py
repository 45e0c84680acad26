"""H = p^T M(q)^{-1} p / 2 + V(q): coupled bodies in generalised coordinates, with a learned mass matrix."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ahnn.dynamics.energies import energy_units
from ahnn.dynamics.inputs import InputName, ScaledStates
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.statistics import Statistics


class MassMatrixHamiltonian(ScaledStates):
    """H = p^T M(q)^{-1} p / 2 + V(q) with one network of the positions.

    The inverse is L(q) L(q)^T with lower triangular L, so that the kinetic energy is non-negative. The
    network outputs are L minus the identity, in units of the data, and V.

    The arguments are those of `ScaledStates`, and the width, depth and activation of the network.
    """

    units: Tensor
    elements: Tensor

    def __init__(
        self, dof: int, network: dict[str, Any], inputs: InputName, scaling: Kind, angular: list[bool] | None
    ) -> None:
        super().__init__(dof, inputs, scaling, angular)
        rows, columns = torch.tril_indices(dof, dof)
        self.network = make_network(self.positions.size, len(rows) + 1, network)
        elements = torch.zeros(len(rows), dof, dof)
        elements[torch.arange(len(rows)), rows, columns] = 1.0
        self.register_buffer("elements", elements)
        self.register_buffer("units", torch.ones(2))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and the units of V and T from the training split."""
        super().fit(statistics)
        self.units.copy_(torch.stack(energy_units(statistics)))

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., F), at the states x, shape (..., D)."""
        return self.positions(x.chunk(2, dim=-1)[0])

    def triangle(self, y: Tensor) -> Tensor:
        """Return L, shape (..., n, n), from network outputs y, in units of the scaled momenta."""
        size = self.elements.shape[-1]
        return torch.eye(size).to(y) + torch.einsum("...k,kij->...ij", y[..., :-1], self.elements)

    def scaled(self, p: Tensor) -> Tensor:
        """Return momenta, shape (..., n), scaled to order one; zero stays zero."""
        return p / self.momenta.affine.scale

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        y = self.network(self.positions(q))
        along = (self.triangle(y).mT @ self.scaled(p).unsqueeze(-1)).squeeze(-1)
        return self.units[0] * y[..., -1] + self.units[1] * along.square().sum(-1) / 2

    def forward(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), shape (..., D), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        z, to_positions = self.positions.linearised(q)
        y, to_inputs = self.network.linearised(z)
        lower, p = self.triangle(y), self.scaled(p)
        along = (lower.mT @ p.unsqueeze(-1)).squeeze(-1)
        velocity = self.scaled(self.units[1] * (lower @ along.unsqueeze(-1)).squeeze(-1))
        # dT/dL_ij = p_i (L^T p)_j, and V is itself an output.
        kinetic = self.units[1] * torch.einsum("kij,...i,...j->...k", self.elements, p, along)
        by = torch.cat((kinetic, self.units[0].expand_as(kinetic[..., :1])), dim=-1)
        return torch.cat((velocity, -to_positions(to_inputs(by))), dim=-1)
