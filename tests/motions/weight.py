"""A known force beside what is learned: a constant weight on each coordinate."""

from typing import final

import torch
from torch import Tensor

from ahnn.dynamics.forces import Force, Instant


@final
class Weight(Force):
    """The force w of a known weight, whose potential is -w q."""

    assumes = "known weight"

    def __init__(self, dof: int, controls: int = 0, *, force: list[float]) -> None:
        super().__init__()
        del dof, controls
        self.known = force

    def forward(self, at: Instant) -> Tensor:
        """Return w, shape (..., n)."""
        return torch.tensor(self.known, dtype=torch.float64).to(at.q).expand_as(at.q)

    def potential(self, at: Instant) -> Tensor:
        """Return -w q, shape (...)."""
        return -(self(at) * at.q).sum(-1)
