"""What a measurement model is, and what it sees of a state."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

Time = float | Tensor
"""One time for all states, or a tensor (...) with a time for each."""


class Measurement(Protocol):
    """Map of states to measurements; see `ahnn.measurements.angles` for what their difference means.

    Attributes:
        names: of the M components.
        units: of the M components. Those in rad or deg are angles, unless the model has `periods` of the M
            components, inf of one that does not come again, such as a counter of turns.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the M components."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the M components."""
        ...

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D) at time t."""
        ...


@runtime_checkable
class Sighted(Protocol):
    """A measurement model that does not see every state."""

    def in_view(self, x: Tensor, t: Time) -> Tensor:
        """Return which of the M numbers are measured of the states x (..., D) at time t, (..., M) bool."""
        ...


@runtime_checkable
class Locating(Protocol):
    """A measurement model that positions can be read off: where a fit of unknown states may begin."""

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions (..., n), or the whole states (..., 2n), that give y (..., M) at time t."""
        ...


@runtime_checkable
class Sloped(Protocol):
    """A measurement model that knows its derivatives, and need not be differentiable by torch."""

    def slope(self, x: Tensor, t: Time) -> Tensor:
        """Return the derivatives (B, M, D) by the states x (B, D) at time t."""
        ...


def observe(measurement: Measurement, x: Tensor, t: Time) -> Tensor:
    """Return what an instrument gives: its measurements (..., M), NaN of states that are out of its view.

    The model itself, `measurement(x, t)`, has a value for every state: a filter needs it for sigma points
    that lie behind the horizon while the satellite does not.

    Args:
        measurement: the model; one without `in_view` sees every state.
        x: (..., D) states.
        t: time, or one for each state.
    """
    y = measurement(x, t)
    if isinstance(measurement, Sighted):
        return torch.where(measurement.in_view(x, t), y, torch.nan)
    return y


def check_state(x: Tensor, least: int, who: str) -> None:
    """Refuse states with too few components.

    Raises:
        ValueError: x has fewer than `least` components; begins with `who`.
    """
    if x.shape[-1] < least:
        message = f"{who}: expected states of at least {least} components; received {tuple(x.shape)}"
        raise ValueError(message)
