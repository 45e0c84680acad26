"""Learned force in the axes of an orbit: radial, along the motion and normal to its plane."""

from __future__ import annotations

from typing import Annotated, final

import torch
from torch import Tensor, nn

from ahnn.arguments import Positive, Within, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.errors import UserError


@final
@checked
class OrbitalForce(Force):
    """Force mu / r^2 (R / r)^k (a, b, c) in radial, transverse and normal axes, per unit mass.

    a, b and c are polynomials in h^2 / (mu r) - 1 and h v_r / mu, with angular momentum h and radial velocity
    v_r. In two-body motion these are e cos f and e sin f, with eccentricity e and true anomaly f. The
    coefficients are learned, starting from zero. In general, the force depends on velocities and positions.

    Args:
        dof: 3.
        controls: not used.
        mu: gravitational parameter of the centre.
        radius: R, in the unit of the positions.
        falloff: k.
        degree: total degree of the polynomials.

    Raises:
        UserError: not three coordinates.
    """

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        mu: Positive,
        radius: Positive,
        falloff: Annotated[int, Within(0, 9)] = 2,
        degree: Annotated[int, Within(0, 5)] = 2,
    ) -> None:
        super().__init__()
        if dof != 3:
            message = f"orbital: expected three coordinates; received {dof}"
            raise UserError(message)
        self.mu, self.radius, self.falloff = mu, radius, falloff
        self.powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        self.assumes = f"a force of degree {degree} in axes of the orbit"
        self.coefficients = nn.Parameter(torch.zeros(len(self.powers), 3))

    def silence(self) -> None:
        """Set the force to zero."""
        self.coefficients.zero_()

    def constants(self) -> dict[str, Tensor]:
        """Return radial, transverse and normal coefficients, (K,) each, ordered by increasing powers."""
        return dict(zip(("radial", "transverse", "normal"), self.coefficients.unbind(1), strict=True))

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., 3); NaN for motion along a radius."""
        r, h = at.q.norm(dim=-1, keepdim=True), torch.linalg.cross(at.q, at.v)
        size, radial = h.norm(dim=-1, keepdim=True), at.q / r
        rise = (radial * at.v).sum(-1, keepdim=True)
        cosine, sine = size**2 / (self.mu * r) - 1, size * rise / self.mu
        terms = torch.cat([cosine**i * sine**j for i, j in self.powers], dim=-1)
        a, b, c = (terms @ self.coefficients.to(terms)).split(1, dim=-1)
        transverse, normal = (at.v - rise * radial) * (r / size), h / size
        strength = self.mu / r**2 * (self.radius / r) ** self.falloff
        return strength * (a * radial + b * transverse + c * normal)
