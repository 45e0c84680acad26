"""A force: what is added to Hamilton's equations, known or learned."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.func import jacrev, vmap

from ahnn.statistics import Statistics


class Instant(NamedTuple):
    """What a force may depend on.

    Attributes:
        t: time, (..., 1); (..., 0) where nothing depends on it.
        u: controls, (..., m).
        q: coordinates, (..., n).
        v: velocities dq/dt, (..., n).
    """

    t: Tensor
    u: Tensor
    q: Tensor
    v: Tensor


class Force(nn.Module, ABC):
    """A generalised force f(t, q, v, u), added to dp/dt.

    Attributes:
        assumes: what it takes as known, for tables.
        timed: whether it depends on time.
        controlled: whether it depends on controls.
    """

    assumes: str
    timed: ClassVar[bool] = False
    controlled: ClassVar[bool] = False

    def fit(self, statistics: Statistics) -> None:
        """Set scalings, units and first guesses from the training split."""

    @abstractmethod
    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., n)."""

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return how the force changes to first order with its arguments, shape (B, R, n).

        Args:
            at: what it depends on, B of each.
            by: changes of that, (B, R, ...). By default reverse mode gives the derivatives.
        """
        sizes = [part.shape[-1] for part in at]

        def of_row(row: Tensor) -> Tensor:
            return self(Instant(*row.split(sizes, dim=-1)))

        return torch.cat(by, dim=-1) @ vmap(jacrev(of_row))(torch.cat(at, dim=-1)).mT

    def constants(self) -> dict[str, Tensor]:
        """Return learned numbers that mean something by themselves, by name, as the parameters give them."""
        return {}

    def potential(self, at: Instant) -> Tensor | None:
        """Return the potential energy of a force that has one, shape (...); by default it has none."""
        del at
        return None
