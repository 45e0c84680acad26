"""Known gravity of a planet: point mass and oblateness."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from ahnn.arguments import Finite, Positive, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.hessians import point_mass_derivatives
from ahnn.errors import UserError

POLAR = (0.0, 0.0, 2.0)
"""Term of the oblateness force that acts only along the polar axis."""


@final
@checked
class CentralAttraction(Force):
    """Attraction -m mu q / r^3 of a point mass at the origin.

    Args:
        dof: degrees of freedom n.
        controls: not used.
        mu: gravitational parameter.
        mass: mass m of the moving body.
    """

    assumes = "known point mass"

    def __init__(self, dof: int, controls: int = 0, *, mu: Positive, mass: Positive = 1.0) -> None:
        super().__init__()
        self.strength = mass * mu

    def forward(self, at: Instant) -> Tensor:
        """Return the attraction, shape (..., n)."""
        return -self.strength * at.q / at.q.norm(dim=-1, keepdim=True) ** 3

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation with q, shape (B, R, n)."""
        return -by.q @ point_mass_derivatives(self.strength, at.q)[1]

    def potential(self, at: Instant) -> Tensor:
        """Return -m mu / r, shape (...)."""
        return -self.strength / at.q.norm(dim=-1)


@final
@checked
class Oblateness(Force):
    """Perturbation by the second zonal harmonic (Vallado, section 8.7.1).

    Args:
        dof: 3, with the polar axis last.
        controls: not used.
        mu: gravitational parameter.
        radius: equatorial radius, in the unit of the positions.
        j2: second zonal harmonic.
        mass: mass m of the moving body.

    Raises:
        UserError: not three coordinates.
    """

    assumes = "known oblateness"

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        mu: Positive,
        radius: Positive,
        j2: Finite,
        mass: Positive = 1.0,
    ) -> None:
        super().__init__()
        if dof != 3:
            message = f"oblateness: expected three coordinates; received {dof}"
            raise UserError(message)
        self.strength = 1.5 * j2 * radius**2 * mass * mu

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., 3)."""
        square = at.q.square().sum(-1, keepdim=True)
        sine2 = at.q[..., 2:].square() / square
        return (
            -self.strength
            / square**2.5
            * at.q
            * (1 - 5 * sine2 + torch.tensor(POLAR, dtype=torch.float64).to(at.q))
        )

    def potential(self, at: Instant) -> Tensor:
        """Return the potential energy, shape (...)."""
        square = at.q.square().sum(-1)
        return self.strength / 3 * (3 * at.q[..., 2].square() / square - 1) / square**1.5
