"""Actuation G u: generalised forces of controls."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, final

import torch
from torch import Tensor, nn

from ahnn.arguments import Finite, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics


@final
@checked
class Actuation(Force):
    """Force G u of controls u: the port of a port-Hamiltonian system, with supplied power v^T G u.

    Args:
        dof: degrees of freedom n.
        controls: number m of controls.
        matrix: input matrix G, n rows of m numbers; None to learn it.
        of: `constant`, or `positions` for G(q) given by a network.
        network: width, depth, activation of G(q).
        scaling: scaling of the network's position inputs.

    Raises:
        UserError: a matrix of the wrong shape, or a matrix with `of` = `positions`.
    """

    controlled: ClassVar[bool] = True
    unit: Tensor

    def __init__(
        self,
        dof: int,
        controls: int,
        *,
        matrix: list[list[Finite]] | None = None,
        of: Literal["constant", "positions"] = "constant",
        network: dict[str, Any] | None = None,
        scaling: Kind = "minmax",
    ) -> None:
        super().__init__()
        self.shape, self.of, self.known = (dof, controls), of, matrix
        self.assumes = "control matrix" if matrix is None else "known control matrix"
        self.register_buffer("unit", torch.ones(controls))
        if matrix is not None and of != "constant":
            message = f"actuation: expected no matrix with of={of}; received {matrix}"
            raise UserError(message)
        if matrix is not None:
            if [len(row) for row in matrix] != [controls] * dof:
                message = f"actuation: expected {dof} rows of {controls} numbers; received {matrix}"
                raise UserError(message)
        elif of == "constant":
            self.weight = nn.Parameter(torch.zeros(dof, controls))
        else:
            self.positions = Cartesian(dof, scaling, 0)
            options = network or {"width": 16, "depth": 1, "activation": "tanh"}
            self.network = make_network(dof, dof * controls, options)

    def fit(self, statistics: Statistics) -> None:
        """Set the scaling, and the unit of G such that typical controls give typical forces."""
        if self.known is not None:
            return
        sizes = statistics.clock[:, 1:].square().mean(0).sqrt()
        self.unit.copy_(statistics.rate.chunk(2)[1].mean() / sizes.clamp(min=1e-300))
        if self.of == "positions":
            self.positions.fit(statistics)

    def matrix(self, q: Tensor) -> Tensor:
        """Return G, shape (..., n, m), at the positions q, shape (..., n)."""
        if self.known is not None:
            return torch.tensor(self.known, dtype=torch.float64).to(q).expand(*q.shape[:-1], *self.shape)
        if self.of == "constant":
            return (self.unit * self.weight).expand(*q.shape[:-1], *self.shape)
        return self.unit * self.network(self.positions(q)).unflatten(-1, self.shape)

    def constants(self) -> dict[str, Tensor]:
        """Return G, (n, m), if it is constant and learned."""
        learned = self.of == "constant" and self.known is None
        return {"matrix": self.unit * self.weight} if learned else {}

    def forward(self, at: Instant) -> Tensor:
        """Return G u, shape (..., n)."""
        return (self.matrix(at.q) @ at.u.unsqueeze(-1)).squeeze(-1)

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation, (B, R, n): G du for constant G, or that of G(q) u by reverse mode."""
        return super().variation(at, by) if hasattr(self, "network") else self(by)
