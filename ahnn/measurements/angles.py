"""Residuals of measurements, with wrapped angles."""

from __future__ import annotations

import math
from typing import Protocol, cast, runtime_checkable

import torch
from torch import Tensor

from ahnn.measurements.base import Measurement
from ahnn.numbers import described

TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "°": 360.0}
"""Full turn in each unit of angles."""


@runtime_checkable
class HasResidual(Protocol):
    """Measurement model with its own residuals."""

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, shape (..., M); angles are wrapped afterwards."""
        ...


def periods(measurement: Measurement) -> tuple[float, ...]:
    """Return the periods of the components that are angles, and inf for all others.

    Raises:
        ValueError: the declared periods are not M positive numbers.
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

    All filters, smoothers, fits and forecasts use it for their residuals.

    Raises:
        ValueError: the model's own residuals have a wrong shape.
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
    """Mixin that gives measurement models the method `residual`."""

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, shape (..., M), angles wrapped."""
        return wrapped(y - y_pred, periods(cast(Measurement, self)))


def nearest(measurement: Measurement, y: Tensor, y_pred: Tensor) -> Tensor:
    """Return y (..., M) with angles turned to within half a turn of y_pred; other components unchanged."""
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
    """Return the angle in (-turn / 2, turn / 2]; angles already in range are unchanged."""
    turned = angle - turn * torch.round(angle / turn)
    # Rounding may leave the value just outside.
    turned = torch.where(turned > 0.5 * turn, turned - turn, turned)
    return torch.where(turned <= -0.5 * turn, turned + turn, turned)


def continuous(values: Tensor, periods: tuple[float, ...]) -> Tensor:
    """Unwrap the angles in samples (B, T, M).

    A step counts as a wrap if it exceeds half a turn and most steps are below an eighth of a turn: sparse
    samples do not determine the direction of rotation and are unchanged.

    Args:
        values: samples, NaN where missing.
        periods: periods of the M components, inf for components that are not angles.
    """
    found = values.clone()
    for c, turn in enumerate(periods):
        if math.isinf(turn):
            continue
        for row in found[..., c]:
            there = row.isfinite()
            seen = row[there]
            steps = seen.diff()
            if len(steps) and float(steps.abs().median()) < turn / 8:
                turns = torch.round(steps / turn) * (steps.abs() > turn / 2)
                row[there] = seen - turn * torch.nn.functional.pad(turns.cumsum(0), (1, 0))
    return found
