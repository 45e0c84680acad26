"""An angle that winds: a pendulum that goes over the top in either direction."""

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.systems import FilterNoise, Range, System, Units, uniform


@final
@dataclass(frozen=True, kw_only=True)
class Rotor(System):
    """H = p^2 / 2 I + a (1 - cos q), with more energy than the top has; SI units."""

    torque: float = 9.81
    q0: Range = (-3.0, 3.0)
    p0: Range = (7.0, 9.0)

    dof = 1
    components = ("angle", "p")
    units = Units(time="s", position="rad", velocity="rad/s", energy="J")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    def energy(self, x: Tensor) -> Tensor:
        """Return H in J, shape (...)."""
        q, p = x.unbind(-1)
        return p * p / (2 * self.inertia) + self.torque * (1 - q.cos())

    def force(self, q: Tensor) -> Tensor:
        """Return -a sin q in N m, shape (..., 1)."""
        return -self.torque * q.sin()

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw angles, and momenta of either sign, shape (count, 2)."""
        q, p = uniform(self.q0, count, generator), uniform(self.p0, count, generator)
        sign = torch.where(torch.rand(count, generator=generator) < 0.5, -1.0, 1.0)
        return torch.stack((q, sign * p), dim=-1)
