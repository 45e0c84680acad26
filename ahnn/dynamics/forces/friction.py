"""Friction -R v with symmetric positive semidefinite R, which never adds energy."""

from __future__ import annotations

from typing import Any, Literal, final

import torch
from torch import Tensor, nn

from ahnn.arguments import NonNegative, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics

FIRST = 0.01
"""Initial value of a learned coefficient, as a fraction of typical force over typical velocity."""


@final
@checked
class Friction(Force):
    """Force -R v, v = dq/dt: dissipation of a port-Hamiltonian system, dH/dt = -v^T R v.

    Args:
        dof: degrees of freedom n.
        controls: not used.
        coefficient: friction coefficient in units of force over velocity, common or per coordinate; None to
            learn a positive one per coordinate.
        of: `constant`; `matrix`: R = L L^T with a learned lower triangular L, which couples coordinates; or
            `positions`: R(q) = L(q) L(q)^T with a network for L (van der Schaft & Jeltsema 2014,
            Port-Hamiltonian Systems Theory, chapter 2).
        network: width, depth, activation of L(q).
        scaling: scaling of the network's position inputs.

    Raises:
        UserError: negative coefficients, a wrong number of them, or coefficients for a learned matrix.
    """

    unit: Tensor

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        coefficient: NonNegative | list[NonNegative] | None = None,
        of: Literal["constant", "matrix", "positions"] = "constant",
        network: dict[str, Any] | None = None,
        scaling: Kind = "minmax",
    ) -> None:
        super().__init__()
        self.dof, self.of, self.known = dof, of, None
        self.assumes = "friction"
        if of != "constant" and coefficient is not None:
            message = f"friction: expected no coefficient with of={of}; received {coefficient}"
            raise UserError(message)
        if of == "matrix":
            self.lower = nn.Parameter(FIRST**0.5 * torch.eye(dof)[*torch.tril_indices(dof, dof)])
            self.register_buffer("unit", torch.ones(dof))
        elif of == "positions":
            self.positions = Cartesian(dof, scaling, 0)
            size = dof * (dof + 1) // 2
            self.network = make_network(dof, size, network or {"width": 16, "depth": 1, "activation": "tanh"})
            self.register_buffer("unit", torch.ones(()))
        elif coefficient is None:
            self.log_coefficient = nn.Parameter(torch.zeros(dof))
        else:
            self.known = coefficient if isinstance(coefficient, list) else [coefficient] * dof
            self.assumes = "known friction"
            if len(self.known) != dof:
                message = f"friction: expected {dof} coefficients >= 0; received {coefficient}"
                raise UserError(message)

    def fit(self, statistics: Statistics) -> None:
        """Set the scaling, and the initial size of a learned friction."""
        rate_q, rate_p = statistics.rate.chunk(2)
        typical = rate_p / rate_q
        if self.of == "matrix":
            self.unit.copy_(typical.sqrt())
        elif self.of == "positions":
            self.positions.fit(statistics)
            self.unit.copy_(typical.mean().sqrt())
        elif self.known is None:
            self.log_coefficient.data.copy_((FIRST * typical).log())

    def coefficients(self) -> Tensor:
        """Return the constant coefficients, shape (n,)."""
        if self.known is not None:
            return torch.tensor(self.known, dtype=torch.float64)
        return self.log_coefficient.exp()

    def constants(self) -> dict[str, Tensor]:
        """Return learned constant coefficients, (n,), or the lower triangle of a learned R, row by row."""
        if self.of == "matrix":
            rows, columns = torch.tril_indices(self.dof, self.dof)
            return {"matrix": self._square(self.lower)[rows, columns]}
        learned = self.of == "constant" and self.known is None
        return {"coefficient": self.coefficients()} if learned else {}

    def matrix(self, q: Tensor) -> Tensor:
        """Return R, shape (..., n, n), at the positions q, shape (..., n)."""
        if self.of == "constant":
            return self.coefficients().to(q).diag().expand(*q.shape, -1)
        if self.of == "matrix":
            return self._square(self.lower.to(q)).expand(*q.shape, -1)
        return self._square(self.network(self.positions(q)))

    def _square(self, entries: Tensor) -> Tensor:
        """Return L L^T, shape (..., n, n), from the entries of lower triangles, (..., n (n + 1) / 2)."""
        rows, columns = torch.tril_indices(self.dof, self.dof, device=entries.device)
        places = (rows * self.dof + columns).expand(entries.shape)
        lower = entries.new_zeros(*entries.shape[:-1], self.dof**2).scatter(-1, places, entries)
        lower = self.unit.unsqueeze(-1) * lower.unflatten(-1, (self.dof, self.dof))
        return lower @ lower.mT

    def forward(self, at: Instant) -> Tensor:
        """Return -R v, shape (..., n)."""
        if self.of == "constant":
            return -self.coefficients().to(at.v) * at.v
        return -(self.matrix(at.q) @ at.v.unsqueeze(-1)).squeeze(-1)

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation, (B, R, n): -R dv for constant R, or that of -R(q) v by reverse mode."""
        return super().variation(at, by) if self.of == "positions" else self(by)
