"""Periodic forcing at a known frequency."""

from __future__ import annotations

from typing import ClassVar, final

import torch
from torch import Tensor, nn

from ahnn.arguments import Finite, Positive, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.errors import UserError
from ahnn.statistics import Statistics


@final
@checked
class Forcing(Force):
    """Periodic force a cos(w t) + b sin(w t).

    Args:
        dof: degrees of freedom n.
        controls: not used.
        frequency: angular frequency w, in radians per unit of time.
        cosine: amplitudes a, n numbers. If only one of a and b is given, the other is zero; if neither is
            given, both are learned.
        sine: amplitudes b, n numbers.

    Raises:
        UserError: a wrong number of amplitudes.
    """

    timed: ClassVar[bool] = True
    unit: Tensor

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        frequency: Positive,
        cosine: list[Finite] | None = None,
        sine: list[Finite] | None = None,
    ) -> None:
        super().__init__()
        self.frequency, self.known = frequency, None
        self.assumes = f"forcing at {frequency:g} rad per unit of time"
        self.register_buffer("unit", torch.ones(dof))
        if cosine is None and sine is None:
            self.amplitudes = nn.Parameter(torch.zeros(2, dof))
            return
        given = [cosine or [0.0] * dof, sine or [0.0] * dof]
        if any(len(part) != dof for part in given):
            message = f"forcing: expected {dof} amplitudes; received cosine={cosine}, sine={sine}"
            raise UserError(message)
        self.known = given
        self.assumes = "known forcing"

    def fit(self, statistics: Statistics) -> None:
        """Set the unit of learned amplitudes to the typical force."""
        if self.known is None:
            self.unit.copy_(statistics.rate.chunk(2)[1])

    def silence(self) -> None:
        """Set learned amplitudes to zero."""
        if self.known is None:
            self.amplitudes.zero_()

    def amplitude(self, like: Tensor) -> Tensor:
        """Return a and b, shape (2, n)."""
        if self.known is not None:
            return torch.tensor(self.known, dtype=torch.float64).to(like)
        return self.unit * self.amplitudes

    def constants(self) -> dict[str, Tensor]:
        """Return a and b, (n,) each, if they are learned."""
        if self.known is not None:
            return {}
        return dict(zip(("cosine", "sine"), self.unit * self.amplitudes, strict=True))

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., n)."""
        phase, (a, b) = self.frequency * at.t, self.amplitude(at.q)
        return a * phase.cos() + b * phase.sin()

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation w (b cos(w t) - a sin(w t)) dt, shape (B, R, n)."""
        phase, (a, b) = self.frequency * at.t, self.amplitude(at.q)
        rate = self.frequency * (b * phase.cos() - a * phase.sin())
        return by.t * rate.unsqueeze(1)
