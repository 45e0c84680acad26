"""What a measurement model is, what it sees of a state, and angles that wrap."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

Time = float | Tensor
"""One time for all states, or a tensor (...) with a time for each."""


class Measurement(Protocol):
    """Map of states to measurements, and what their difference means.

    Attributes:
        names: of the M components.
        units: of the M components.
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

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, shape (..., M), with angles wrapped to (-pi, pi]."""
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


def wrap(angle: Tensor) -> Tensor:
    """Return the angle in (-pi, pi]; an angle that is already there is returned as it is, bit for bit."""
    turned = angle - 2.0 * math.pi * torch.round(angle / (2.0 * math.pi))
    # Rounding may have put it just outside.
    turned = torch.where(turned > math.pi, turned - 2.0 * math.pi, turned)
    return torch.where(turned <= -math.pi, turned + 2.0 * math.pi, turned)


def check_state(x: Tensor, least: int, who: str) -> None:
    """Refuse states with too few components.

    Raises:
        ValueError: x has fewer than `least` components; begins with `who`.
    """
    if x.shape[-1] < least:
        message = f"{who}: expected states of at least {least} components; received {tuple(x.shape)}"
        raise ValueError(message)
