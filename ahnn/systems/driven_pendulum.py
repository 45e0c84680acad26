"""Pendulum with friction and a periodic torque: m l^2 q'' = -m g l sin q - r q' + a cos(w t)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

from ahnn.arguments import Finite, NonNegative, Positive
from ahnn.dynamics.forces import Force, Forcing, Friction
from ahnn.systems.pendulum import Pendulum


@final
@dataclass(frozen=True, kw_only=True)
class DrivenPendulum(Pendulum):
    """Driven, damped pendulum.

    Attributes:
        friction: r, torque over angular velocity, in kg m^2/s.
        torque: amplitude a of the drive, in N m; 0 for no drive.
        frequency: w of the drive, in rad/s.
    """

    friction: NonNegative = 0.05
    torque: Finite = 0.0
    frequency: Positive = 1.0

    integrator = "dopri8"

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Friction, and the drive if nonzero."""
        drive = Forcing(1, frequency=self.frequency, cosine=[self.torque])
        return (Friction(1, coefficient=self.friction), *([drive] if self.torque else []))
