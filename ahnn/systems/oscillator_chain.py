"""Chains of masses with nonlinear springs between neighbours: Fermi-Pasta-Ulam-Tsingou, and Toda."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, final

import torch
from torch import Generator, Tensor

from ahnn.arguments import Count, Finite, Positive, Within
from ahnn.systems.base import FilterNoise, System, Units


@dataclass(frozen=True, kw_only=True)
class OscillatorChain(System):
    """Chain of masses on a line, H = sum p_i^2 / 2m + sum V(q_{i+1} - q_i), between walls or in a ring.

    Attributes:
        masses: number of masses.
        spread: standard deviation of the initial displacements and velocities.
    """

    masses: Count = 3
    spread: Positive = 0.5

    units = Units(time="1", position="1", velocity="1", energy="1")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @property
    def dof(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of masses."""
        return self.masses

    @property
    def components(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Displacements q1, q2, ... and momenta p1, p2, ..."""
        return tuple(f"{letter}{i}" for letter in "qp" for i in range(1, self.masses + 1))

    @abstractmethod
    def spring(self, stretch: Tensor) -> tuple[Tensor, Tensor]:
        """Return V and its slope, shape (...) each, for given spring elongations."""

    @abstractmethod
    def stretches(self, q: Tensor) -> Tensor:
        """Return the elongations of the springs, shape (..., S), at the displacements q, shape (..., n)."""

    @abstractmethod
    def pulled(self, tension: Tensor) -> Tensor:
        """Return the forces on the masses, shape (..., n), from the spring tensions, shape (..., S)."""

    def energy(self, x: Tensor) -> Tensor:
        """Return the energy, shape (...)."""
        q, p = x.chunk(2, dim=-1)
        return (p * p).sum(-1) / (2 * self.mass) + self.spring(self.stretches(q))[0].sum(-1)

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt, shape (..., n), at the displacements q, shape (..., n)."""
        return self.pulled(self.spring(self.stretches(q))[1])

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw displacements and velocities from normal distributions, shape (count, 2n)."""
        draw: dict[str, Any] = {"generator": generator, "dtype": torch.float64}
        q, v = self.spread * torch.randn(2, count, self.masses, **draw)
        return torch.cat((q, self.mass * v), dim=-1)


@final
@dataclass(frozen=True, kw_only=True)
class FermiPastaChain(OscillatorChain):
    """Springs V(r) = r^2 / 2 + alpha r^3 / 3 + beta r^4 / 4 between walls (Fermi, Pasta & Ulam 1955).

    Attributes:
        alpha: strength of the cubic terms.
        beta: strength of the quartic terms.
    """

    alpha: Finite = 0.0
    beta: Finite = 1.0

    def spring(self, stretch: Tensor) -> tuple[Tensor, Tensor]:
        """Return V and its slope, shape (...) each."""
        value = stretch**2 / 2 + self.alpha * stretch**3 / 3 + self.beta * stretch**4 / 4
        return value, stretch + self.alpha * stretch**2 + self.beta * stretch**3

    def stretches(self, q: Tensor) -> Tensor:
        """Return the elongations of n + 1 springs, the first and the last attached to walls."""
        return torch.nn.functional.pad(q, (1, 1)).diff(dim=-1)

    def pulled(self, tension: Tensor) -> Tensor:
        """Return the difference of tension between the springs after and before each mass."""
        return tension.diff(dim=-1)


@final
@dataclass(frozen=True, kw_only=True)
class TodaChain(OscillatorChain):
    """Springs V(r) = exp(-r) + r - 1 in a ring, integrable (Toda 1967, J. Phys. Soc. Jpn. 22, 431)."""

    masses: Annotated[int, Within(2)] = 3

    def spring(self, stretch: Tensor) -> tuple[Tensor, Tensor]:
        """Return V and its slope, shape (...) each."""
        decay = torch.exp(-stretch)
        return decay + stretch - 1, 1 - decay

    def stretches(self, q: Tensor) -> Tensor:
        """Return the elongations of n springs, the last one attached to the first mass."""
        return q.roll(-1, dims=-1) - q

    def pulled(self, tension: Tensor) -> Tensor:
        """Return the difference of tension between the springs after and before each mass."""
        return tension - tension.roll(1, dims=-1)
