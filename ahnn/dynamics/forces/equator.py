"""Gravity of an elliptic equator, which turns with its planet."""

from __future__ import annotations

from typing import ClassVar, final

import torch
from torch import Tensor, nn

from ahnn.arguments import Finite, Positive, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.errors import UserError


@final
@checked
class EllipticEquator(Force):
    """Sectorial gravity of degree 2 (Montenbruck & Gill, Satellite Orbits, 3.2), per unit mass.

    V = -3 mu R^2 / r^5 (C (x^2 - y^2) + 2 S x y) in axes that turn with the planet about its pole, the third
    axis. C and S are the unnormalised harmonics C22 and S22. Orbits with a period of half a day or a day are
    in resonance with this force.

    Args:
        dof: 3, with the polar axis last.
        controls: not used.
        mu: gravitational parameter.
        radius: equatorial radius R, in the unit of the positions.
        angle: angle from the first axis to the prime meridian at time zero, rad.
        rate: rate of that angle, rad per unit of time.
        cosine: C; None to learn C and S.
        sine: S; None to learn C and S.

    Raises:
        UserError: not three coordinates, or one of C and S without the other.
    """

    timed: ClassVar[bool] = True

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        mu: Positive,
        radius: Positive,
        angle: Finite,
        rate: Finite,
        cosine: Finite | None = None,
        sine: Finite | None = None,
    ) -> None:
        super().__init__()
        if dof != 3 or (cosine is None) != (sine is None):
            message = (
                "elliptic_equator: expected three coordinates, and both cosine and sine or neither; received "
                f"{dof}, {cosine} and {sine}"
            )
            raise UserError(message)
        self.strength, self.angle, self.rate = 3 * mu * radius**2, angle, rate
        self.known = None if cosine is None or sine is None else (cosine, sine)
        self.assumes = "an elliptic equator" if self.known is None else "known elliptic equator"
        if self.known is None:
            self.harmonics = nn.Parameter(torch.zeros(2))

    def silence(self) -> None:
        """Set learned harmonics to zero."""
        if self.known is None:
            self.harmonics.zero_()

    def constants(self) -> dict[str, Tensor]:
        """Return C and S, if they are learned."""
        return {} if self.known is not None else dict(zip(("cosine", "sine"), self.harmonics, strict=True))

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., 3)."""
        c, s = self.harmonics.to(at.q) if self.known is None else at.q.new_tensor(self.known)
        turn = 2 * (self.angle + self.rate * at.t)
        cosine, sine = turn.cos(), turn.sin()
        c, s = c * cosine - s * sine, c * sine + s * cosine
        x, y, _ = at.q.split(1, dim=-1)
        square = at.q.square().sum(-1, keepdim=True)
        slope = torch.cat((2 * (c * x + s * y), 2 * (s * x - c * y), torch.zeros_like(x)), dim=-1)
        form = c * (x**2 - y**2) + 2 * s * x * y
        return self.strength / square**2.5 * (slope - 5 * form / square * at.q)
