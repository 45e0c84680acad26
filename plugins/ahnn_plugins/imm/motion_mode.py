"""Mode of a motion: process noise, and optionally the flow of a known system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, final

import torch
from torch import Tensor

from ahnn.arguments import Within, checked
from ahnn.errors import UserError
from ahnn.estimation.linalg import tria
from ahnn.systems import System, exact_flow
from ahnn.types import Flow

Deviation = Annotated[float, Within(0)]


@final
@checked
@dataclass(frozen=True)
class MotionMode:
    """Process model of one mode.

    Attributes:
        factor: factor on the standard deviations of the filter's process noise.
        added: standard deviations of additional white noise on the first state components, per square root of
            the unit of time; None for no additional noise.
        beside: system whose exact flow replaces the model.
    """

    factor: Deviation = 1.0
    added: list[Deviation] | None = None
    beside: System | None = None

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the mode."""
        known = self.beside
        system = None if known is None else {"is": type(known).__name__, **known.parameters()}
        return {"factor": self.factor, "added": self.added, "beside": system}

    @cached_property
    def own_flow(self) -> Callable[[Flow], Flow]:
        """Function from the flow of the model to the flow of the mode."""
        if self.beside is None:
            return lambda flow: flow
        exact = exact_flow(self.beside)
        return lambda _: exact

    def require_size(self, size: int, who: str) -> None:
        """Raise UserError for states of an incompatible size D."""
        if self.added is not None and len(self.added) > size:
            message = f"{who}.added: expected at most {size} standard deviations; received {len(self.added)}"
            raise UserError(message)
        if self.beside is not None and (own := 2 * self.beside.dof) != size:
            message = (
                f"{who}.beside: expected a system with {size} components, as many as are estimated; received "
                f"{self.beside.name} with {own}, without force error, parameters or biases"
            )
            raise UserError(message)

    def noise(self, chol_q: Tensor, dt: float) -> Tensor:
        """Return the factor (B, D, D) of the mode's process noise in a step, from the filter's factor."""
        chol = self.factor * chol_q
        if self.added is None:
            return chol
        own = chol.new_zeros(chol.shape[-1])
        own[: len(self.added)] = chol.new_tensor(self.added) * dt**0.5
        return tria(torch.cat((chol.mT, torch.diag(own).expand_as(chol)), dim=1))
