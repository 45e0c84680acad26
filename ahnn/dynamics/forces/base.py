"""A force: what is added to Hamilton's equations, known or learned."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

from torch import Tensor, nn

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

    def potential(self, at: Instant) -> Tensor | None:
        """Return the potential energy of a force that has one, shape (...); by default it has none."""
        del at
        return None
