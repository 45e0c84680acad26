"""Two masses, 1 kg and 1,000 kg, on a spring to the wall and one between them."""

from dataclasses import dataclass
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.systems import FilterNoise, System, Units


@final
@dataclass(frozen=True, kw_only=True)
class CoupledMasses(System):
    """H = p1^2 / 2 m1 + p2^2 / 2 m2 + k q2^2 / 2 + c (q1 - q2)^2 / 2; SI units."""

    light: float = 1.0
    heavy: float = 1000.0
    wall: float = 1000.0
    coupling: float = 4.0

    dof = 2
    components = ("q1", "q2", "p1", "p2")
    units = Units(time="s", position="m", velocity="m/s", energy="J")
    integrator = "kahan_li8"
    noise = FilterNoise(position=1e-3, velocity=1e-3, measurement=1e-3)

    @property
    def inertia(self) -> tuple[float, float]:
        """The masses in kg."""
        return self.light, self.heavy

    def energy(self, x: Tensor) -> Tensor:
        """Return H in J, shape (...)."""
        q1, q2, p1, p2 = x.unbind(-1)
        kinetic = p1**2 / (2 * self.light) + p2**2 / (2 * self.heavy)
        return kinetic + self.wall * q2**2 / 2 + self.coupling * (q1 - q2) ** 2 / 2

    def force(self, q: Tensor) -> Tensor:
        """Return the forces of both springs, shape (..., 2)."""
        pull = self.coupling * (q[..., :1] - q[..., 1:])
        return torch.cat((-pull, pull - self.wall * q[..., 1:]), dim=-1)

    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw positions within a metre and velocities within a metre a second, shape (count, 4)."""
        drawn = 2 * torch.rand(count, 4, generator=generator, dtype=torch.float64) - 1
        return drawn * self.space.scales
