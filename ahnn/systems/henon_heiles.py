"""Hénon-Heiles system: H = (p_x^2 + p_y^2 + x^2 + y^2) / 2 + x^2 y - y^3 / 3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Range
from ahnn.systems.base import FilterNoise, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class HenonHeiles(System):
    """Star in an axisymmetric galaxy, regular and chaotic (Hénon & Heiles 1964, Astron. J. 69, 73).

    Bounded for energies below 1/6, as ensured by the default ranges.

    Attributes:
        amplitude: range of the initial components of q and p.
    """

    amplitude: Range = (-0.2, 0.2)

    dof = 2
    components = ("x", "y", "px", "py")
    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def energy(self, x: Tensor) -> Tensor:
        """Return the Hénon-Heiles Hamiltonian, shape (...)."""
        q, p = x.chunk(2, dim=-1)
        a, b = q.unbind(-1)
        kinetic = (p * p).sum(-1) / (2 * self.mass)
        return kinetic + (q * q).sum(-1) / 2 + a * a * b - b**3 / 3

    def force(self, q: Tensor) -> Tensor:
        """Return (-x - 2 x y, -y - x^2 + y^2), shape (..., 2)."""
        a, b = q.unbind(-1)
        return torch.stack((-a - 2 * a * b, -b - a * a + b * b), dim=-1)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw all four components uniformly, shape (count, 4)."""
        draws = uniform(self.amplitude, 4 * count, generator)
        return draws.reshape(count, 4)
