"""What a measurement model is, what it sees of a state, and angles that wrap."""

from __future__ import annotations

import math
from typing import Protocol, cast, runtime_checkable

import torch
from torch import Tensor

from ahnn.numbers import described

Time = float | Tensor
"""One time for all states, or a tensor (...) with a time for each."""


TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "°": 360.0}
"""A turn in each unit of angles."""


class Measurement(Protocol):
    """Map of states to measurements; see `residual` for what their difference means.

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
class HasResidual(Protocol):
    """A measurement model whose differences are no plain ones."""

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return what y is more than y_pred, shape (..., M); angles are wrapped afterwards."""
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


def periods(measurement: Measurement) -> tuple[float, ...]:
    """Return the period of each component that is an angle, inf of the others.

    Raises:
        ValueError: a model that declares others than M positive numbers.
    """
    declared = getattr(measurement, "periods", None)
    if declared is None:
        units = getattr(measurement, "units", None) or ("",) * len(measurement.names)
        return tuple(TURNS.get(unit, math.inf) for unit in units)
    if len(declared) != len(measurement.names) or not all(period > 0.0 for period in declared):
        names = ", ".join(measurement.names)
        message = f"periods: expected a number > 0, or inf, for each of {names}; received {declared}"
        raise ValueError(message)
    return tuple(declared)


def residual(measurement: Measurement, y: Tensor, y_pred: Tensor) -> Tensor:
    """Return y - y_pred, shape of y (..., M), angles wrapped to half a turn on either side of zero.

    Every residual is formed here: of filters, smoothers, fits and forecasts.

    Raises:
        ValueError: the model has differences of its own, of another shape.
    """
    if not isinstance(measurement, HasResidual):
        return wrapped(y - y_pred, periods(measurement))
    difference: object = measurement.residual(y, y_pred)
    if not isinstance(difference, Tensor) or difference.shape != y.shape or difference.is_complex():
        message = (
            f"measurement: expected residual(y, y_pred) to return a real tensor {tuple(y.shape)} for y "
            f"of that shape and y_pred {tuple(y_pred.shape)}; received {described(difference)}"
        )
        raise ValueError(message)
    return wrapped(difference, periods(measurement))


class Differing:
    """What the models here have in common: `residual` as a method."""

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, shape (..., M), angles wrapped."""
        return wrapped(y - y_pred, periods(cast(Measurement, self)))


def nearest(measurement: Measurement, y: Tensor, y_pred: Tensor) -> Tensor:
    """Return y (..., M) with angles turned to within half a turn of y_pred; the others bit for bit."""
    turns = periods(measurement)
    if all(map(math.isinf, turns)):
        return y
    plain = y - y_pred
    turned = wrapped(plain, turns)
    return torch.where((turned == plain) | plain.isnan(), y, y_pred + turned)


def wrapped(difference: Tensor, periods: tuple[float, ...]) -> Tensor:
    """Return differences (..., M) whose components with a finite period are wrapped."""
    if all(map(math.isinf, periods)):
        return difference
    turns = difference.new_tensor(periods)
    angles = turns.isfinite()
    return torch.where(angles, wrap(difference, torch.where(angles, turns, 1.0)), difference)


def wrap(angle: Tensor, turn: float | Tensor = TURNS["rad"]) -> Tensor:
    """Return the angle in (-turn / 2, turn / 2]; one that is already there is returned bit for bit."""
    turned = angle - turn * torch.round(angle / turn)
    # Rounding may have put it just outside.
    turned = torch.where(turned > 0.5 * turn, turned - turn, turned)
    return torch.where(turned <= -0.5 * turn, turned + turn, turned)


def check_state(x: Tensor, least: int, who: str) -> None:
    """Refuse states with too few components.

    Raises:
        ValueError: x has fewer than `least` components; begins with `who`.
    """
    if x.shape[-1] < least:
        message = f"{who}: expected states of at least {least} components; received {tuple(x.shape)}"
        raise ValueError(message)
