"""Planar chain of pendulums, with the angle of each link from the downward vertical."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Count, Positive, Range
from ahnn.errors import UserError
from ahnn.systems.base import FilterNoise, Units, uniform
from ahnn.systems.generalised_coordinates import MassMatrixSystem


@final
@dataclass(frozen=True, kw_only=True)
class ChainPendulum(MassMatrixSystem):
    """Chain of point masses on rigid rods; two links form the chaotic double pendulum.

    M_ij = m_{>= max(i, j)} l_i l_j cos(q_i - q_j) and V = -sum_i m_{>= i} g l_i cos q_i, where m_{>= i} is
    the mass of link i and all later links (Finzi, Wang & Wilson 2020, arXiv:2010.13581, use the Cartesian
    form).

    Attributes:
        links: number of links.
        masses: masses of the links in kg, from the top; None for 1 each.
        lengths: lengths of the links in m; None for 1 each.
        gravity: acceleration in m/s^2.
        q0: range of the initial angles in rad.
        v0: range of their rates in rad/s.
    """

    links: Count = 2
    masses: list[Positive] | None = None
    lengths: list[Positive] | None = None
    gravity: Positive = 9.81
    q0: Range = (-1.5, 1.5)
    v0: Range = (0.0, 0.0)

    units = Units(time="s", position="rad", velocity="rad/s", energy="J")
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def __post_init__(self) -> None:
        """Raise UserError for invalid parameters."""
        super().__post_init__()
        for name in ("masses", "lengths"):
            if (given := getattr(self, name)) is not None and len(given) != self.links:
                message = f"{name}: expected one number for each of {self.links} links; received {given}"
                raise UserError(message)

    @property
    def dof(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of links."""
        return self.links

    @property
    def components(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Names of angles, then momenta."""
        return tuple(f"{kind}{k + 1}" for kind in ("q", "p") for k in range(self.links))

    def numbers(self, given: Sequence[float] | None, like: Tensor) -> Tensor:
        """Expand numbers to one per link, (n,)."""
        return torch.ones(self.links).to(like) if given is None else torch.tensor(given).to(like)

    def couplings(self, like: Tensor) -> Tensor:
        """Return m_{>= max(i, j)} l_i l_j, (n, n)."""
        below = self.numbers(self.masses, like).flip(0).cumsum(0).flip(0)
        last = torch.arange(self.links, device=like.device)
        length = self.numbers(self.lengths, like)
        return below[torch.maximum(last[:, None], last)] * length[:, None] * length

    def weights(self, like: Tensor) -> Tensor:
        """Return m_{>= i} g l_i, (n,)."""
        return self.couplings(like).diagonal() / self.numbers(self.lengths, like) * self.gravity

    def mass_matrix(self, q: Tensor) -> Tensor:
        """Return M, shape (..., n, n), at the angles q, shape (..., n)."""
        return self.couplings(q) * (q.unsqueeze(-1) - q.unsqueeze(-2)).cos()

    def mass_slopes(self, q: Tensor) -> Tensor:
        """Return dM/dq_k, shape (..., n, n, n), at the angles q, shape (..., n)."""
        slope = self.couplings(q) * (q.unsqueeze(-1) - q.unsqueeze(-2)).sin()  # -dM_ij/dq_i = dM_ij/dq_j
        by = torch.eye(self.links).to(q)
        return slope.unsqueeze(-3) * (by[:, None, :] - by[:, :, None])

    def potential(self, q: Tensor) -> Tensor:
        """Return V in J, shape (...), at the angles q, shape (..., n)."""
        return -(self.weights(q) * q.cos()).sum(-1)

    def force(self, q: Tensor) -> Tensor:
        """Return -dV/dq in N m, shape (..., n), at the angles q, shape (..., n)."""
        return -self.weights(q) * q.sin()

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw angles and their rates uniformly, shape (count, 2n)."""
        size = count * self.links
        q, v = (uniform(part, size, generator).reshape(count, self.links) for part in (self.q0, self.v0))
        return self.states(q, v)
