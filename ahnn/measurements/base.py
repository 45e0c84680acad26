"""Protocols of measurement models, and simulation of observations."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

Time = float | Tensor
"""A common time for all states, or a tensor (...) with a time for each."""


class Measurement(Protocol):
    """Map from states to measurements; see `ahnn.measurements.angles` for residuals.

    Attributes:
        names: names of the M components.
        units: units of the M components. Components in rad or deg are angles, unless the model declares
            `periods` of the M components, inf for a non-periodic one, such as a turn counter.
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
    """Measurement model with a limited field of view."""

    def in_view(self, x: Tensor, t: Time) -> Tensor:
        """Return the mask of measured components at states x (..., D) and time t, (..., M) bool."""
        ...


@runtime_checkable
class Locating(Protocol):
    """Measurement model whose measurements give positions, as initial values of fits."""

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions (..., n), or the full states (..., 2n), that produce y (..., M) at time t."""
        ...


@runtime_checkable
class Sloped(Protocol):
    """Measurement model with its own derivatives; torch need not be able to differentiate it."""

    def slope(self, x: Tensor, t: Time) -> Tensor:
        """Return the derivatives (B, M, D) with respect to the states x (B, D) at time t."""
        ...


def observe(measurement: Measurement, x: Tensor, t: Time) -> Tensor:
    """Return the measurements (..., M) of a sensor, NaN for states outside its field of view.

    The model itself, `measurement(x, t)`, is defined for every state: a filter needs it for sigma points
    below the horizon while the satellite is above it.

    Args:
        measurement: measurement model; its view is unlimited if it has no `in_view`.
        x: (..., D) states.
        t: common time, or one per state.
    """
    y = measurement(x, t)
    if isinstance(measurement, Sighted):
        return torch.where(measurement.in_view(x, t), y, torch.nan)
    return y


def check_state(x: Tensor, least: int, who: str) -> None:
    """Check the number of state components.

    Raises:
        ValueError: x has fewer than `least` components; the message begins with `who`.
    """
    if x.shape[-1] < least:
        message = f"{who}: expected states of at least {least} components; received {tuple(x.shape)}"
        raise ValueError(message)
