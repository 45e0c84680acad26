"""Base class of known or learned forces added to Hamilton's equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.func import vjp

from ahnn.statistics import Statistics


class Instant(NamedTuple):
    """Arguments of a force.

    Attributes:
        t: time, (..., 1); (..., 0) for autonomous systems.
        u: controls, (..., m).
        q: coordinates, (..., n).
        v: velocities dq/dt, (..., n).
    """

    t: Tensor
    u: Tensor
    q: Tensor
    v: Tensor


class Force(nn.Module, ABC):
    """Generalised force f(t, q, v, u), added to dp/dt.

    Attributes:
        assumes: prior knowledge that the force assumes, for tables.
        timed: whether the force depends on time.
        controlled: whether the force depends on controls.
    """

    assumes: str
    timed: ClassVar[bool] = False
    controlled: ClassVar[bool] = False

    def fit(self, statistics: Statistics) -> None:
        """Set scalings, units and initial values from the training split."""

    def silence(self) -> None:
        """Set a learned force to zero, from which training can increase it; by default, do nothing."""

    @abstractmethod
    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., n)."""

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the first-order variation of the force, shape (B, R, n); by default in reverse mode.

        Args:
            at: arguments of the force, B of each.
            by: variations of the arguments, (B, R, ...).
        """
        sizes, x = [part.shape[-1] for part in at], torch.cat(at, dim=-1)
        value, pull, *_ = vjp(lambda rows: self(Instant(*rows.split(sizes, dim=-1))), x)
        units = torch.eye(value.shape[-1]).to(value).unbind()
        return torch.cat(by, dim=-1) @ torch.stack([pull(one.expand_as(value))[0] for one in units], dim=-1)

    def constants(self) -> dict[str, Tensor]:
        """Return learned physical constants by name, computed from the parameters."""
        return {}

    def potential(self, at: Instant) -> Tensor | None:
        """Return the potential energy, shape (...), of a conservative force; None by default."""
        return None
