"""A system with time and friction: m q'' = -k q - r q' + a sin(w t)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

from ahnn.dynamics.forces import Force, Forcing, Friction
from ahnn.systems import MassSpring


@final
@dataclass(frozen=True, kw_only=True)
class ForcedOscillator(MassSpring):
    """A mass on a spring, damped and driven; SI units."""

    friction: float = 0.4
    amplitude: float = 1.0
    frequency: float = 1.3

    integrator = "dopri8"

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Friction and the drive."""
        drive = Forcing(1, frequency=self.frequency, sine=[self.amplitude])
        return Friction(1, coefficient=self.friction), drive
