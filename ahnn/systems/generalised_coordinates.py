"""Systems in generalised coordinates: H = p^T M(q)^{-1} p / 2 + V(q), with mass matrix M(q)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from ahnn.systems.base import System


@dataclass(frozen=True, kw_only=True)
class MassMatrixSystem(System):
    """System of coupled bodies with momenta p = M(q) dq/dt, not proportional to velocities."""

    integrator = "dopri8"

    @abstractmethod
    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq, shape (..., n), at the positions q, shape (..., n)."""

    @abstractmethod
    def mass_matrix(self, q: Tensor) -> Tensor:
        """Return M, shape (..., n, n), at the positions q, shape (..., n)."""

    @abstractmethod
    def mass_slopes(self, q: Tensor) -> Tensor:
        """Return dM/dq_k, shape (..., n, n, n), k first, at the positions q, shape (..., n)."""

    @abstractmethod
    def potential(self, q: Tensor) -> Tensor:
        """Return V, shape (...), at the positions q, shape (..., n)."""

    @property
    def separable(self) -> bool:
        """False: H is not a sum T(p) + V(q)."""
        return False

    def velocities(self, x: Tensor) -> Tensor:
        """Return dq/dt = M^{-1} p, shape (..., n), at the states x, shape (..., 2n)."""
        q, p = x.chunk(2, dim=-1)
        return torch.linalg.solve(self.mass_matrix(q), p)

    def states(self, q: Tensor, v: Tensor) -> Tensor:
        """Return the states (q, M(q) v), shape (..., 2n), of positions and velocities, shape (..., n)."""
        return torch.cat((q, (self.mass_matrix(q) @ v.unsqueeze(-1)).squeeze(-1)), dim=-1)

    def energy(self, x: Tensor) -> Tensor:
        """Return p^T M(q)^{-1} p / 2 + V(q) in J, shape (...)."""
        q, p = x.chunk(2, dim=-1)
        return (p * self.velocities(x)).sum(-1) / 2 + self.potential(q)

    def hamiltonian(self, x: Tensor) -> Tensor:
        """Return (M^{-1} p, v^T (dM/dq) v / 2 - dV/dq), shape (..., 2n), at the states x, shape (..., 2n)."""
        v = self.velocities(x)
        q = x.chunk(2, dim=-1)[0]
        carried = torch.einsum("...kij,...i,...j->...k", self.mass_slopes(q), v, v) / 2
        return torch.cat((v, carried + self.force(q)), dim=-1)
