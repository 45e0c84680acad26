"""Harmonic oscillator: H = p^2 / 2m + k q^2 / 2."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from ahnn.arguments import Positive, Range
from ahnn.integrators import INTEGRATORS, GaussLegendre4
from ahnn.systems import spring_steps
from ahnn.systems.base import FilterNoise, System, Units, uniform
from ahnn.types import Flow


@dataclass(frozen=True, kw_only=True)
class MassSpring(System):
    """Mass on a spring (paper, section IV.A); SI units.

    Attributes:
        stiffness: spring constant k in N/m.
        q0: range of the initial position in m.
        p0: range of the initial momentum in kg m/s.
    """

    stiffness: Positive = 5.0
    q0: Range = (-1.0, 1.0)
    p0: Range = (-1.0, 1.0)

    dof = 1
    components = ("q", "p")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "gl4"
    constants = ("stiffness",)
    noise = FilterNoise(position=1e-7**0.5, velocity=1e-7**0.5, measurement=1e-7**0.5)

    def energy(self, x: Tensor) -> Tensor:
        """Return p^2 / 2m + k q^2 / 2 in J, shape (...)."""
        q, p = x.unbind(-1)
        return p * p / (2 * self.mass) + self.stiffness * q * q / 2

    def force(self, q: Tensor) -> Tensor:
        """Return Hooke's force -k q in N, shape (..., 1)."""
        return -self.stiffness * q

    def compiled(self, flow: Flow, longest: float) -> Flow:
        """Return the exact flow, in C if a compiler is available, for these equations alone."""
        method = INTEGRATORS[self.integrator]
        if type(self) is not MassSpring or not isinstance(method, GaussLegendre4):
            return flow
        return spring_steps.SpringFlow(flow, self.stiffness, self.mass, method, longest)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw (q0, p0) uniformly, shape (count, 2)."""
        q = uniform(self.q0, count, generator)
        p = uniform(self.p0, count, generator)
        return torch.stack((q, p), dim=-1)
