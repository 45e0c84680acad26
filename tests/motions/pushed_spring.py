"""A system with a control: a mass on a spring that somebody pushes; a push is held between samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Generator, Tensor

from ahnn.dynamics.forces import Actuation, Force
from ahnn.systems import MassSpring


@final
@dataclass(frozen=True, kw_only=True)
class PushedSpring(MassSpring):
    """m q'' = -k q + g u; SI units."""

    gain: float = 2.0

    controls = ("u",)
    integrator = "dopri8"

    @cached_property
    def forces(self) -> Sequence[Force]:
        """The push."""
        return (Actuation(1, 1, matrix=[[self.gain]]),)

    def signal(self, times: Tensor, count: int, generator: Generator) -> Tensor:
        """Draw pushes that last ten samples, shape (count, T, 1)."""
        pushes = torch.randn(count, -(-len(times) // 10), 1, generator=generator, dtype=torch.float64)
        return pushes.repeat_interleave(10, dim=1)[:, : len(times)]
