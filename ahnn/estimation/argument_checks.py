"""Validation of filter arguments, so that kernels can rely on their inputs.

Covariances are converted to factors, and numbers of any kind to float64 tensors.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance, covariance_factor
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.gate import Gate, thresholds
from ahnn.estimation.state import FilterState, MemberState
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers, as_float64, described

if TYPE_CHECKING:
    from typing_extensions import TypeIs


def check_belief(belief: Belief) -> None:
    """Raise ValueError for anything but a float64 belief of at least one member."""
    if not isinstance(belief, Belief):
        message = f"belief: expected a Belief; received {described(belief)}; use initial_belief"
        raise UserError(message)
    mean, chol = belief
    right = mean.ndim == 2 and len(mean) > 0 and chol.shape == (*mean.shape, mean.shape[1])
    if not right or mean.dtype != torch.float64 or chol.dtype != torch.float64:
        message = (
            f"belief: expected a float64 belief with mean (B, D), B >= 1, and chol (B, D, D); received "
            f"{mean.dtype} {tuple(mean.shape)} and {chol.dtype} {tuple(chol.shape)}; use initial_belief"
        )
        raise ValueError(message)


def check_state(state: MemberState, kind: type[MemberState] = FilterState) -> None:
    """Raise ValueError for anything but a filter state with a valid belief."""
    if not isinstance(state, kind):
        message = f"state: expected a {kind.__name__}; received {described(state)}; use start"
        raise UserError(message)
    check_belief(state.belief)


def checked_sensor(
    measurement: Measurement, noise: Covariance, belief: Belief, gate: Gate | None, *, definite: bool = False
) -> SensorModel:
    """Return a measurement model with the factor of its noise R, (M, M) or (B, M, M).

    Raises:
        ValueError: `measurement` is not a measurement model, or `noise` is not a covariance.
    """
    missing = [name for name in ("names", "__call__") if not hasattr(measurement, name)]
    if missing:
        message = (
            f"measurement: expected a measurement model with names and a call (x, t); received "
            f"{measurement!r} without {', '.join(missing)}; see Measurement"
        )
        raise ValueError(message)
    batch, width, device = len(belief.mean), len(measurement.names), belief.mean.device
    chol_r = covariance_factor(noise, "R", batch=batch, size=width, definite=definite)
    chol_r = chol_r.to(device).expand(batch, width, width)
    if gate is None:
        return SensorModel(measurement, chol_r)
    patience = torch.inf if gate.reopens else gate.patience
    return SensorModel(measurement, chol_r, thresholds(gate, width, device), patience)


def checked_rows(values: Numbers, who: str, shape: tuple[int | str, ...], device: torch.device) -> Tensor:
    """Return measurements as float64.

    Args:
        values: measurements, NaN where a component is missing.
        who: parameter name for messages.
        shape: required shape; the letter T stands for any length of at least 1.
        device: device of the result.

    Raises:
        ValueError: wrong shape, or infinite values.
    """
    rows = as_float64(values, who, device)
    received = tuple(rows.shape)
    same = [n == m or (m == "T" and n > 0) for n, m in zip(received, shape, strict=False)]
    if len(received) != len(shape) or not all(same):
        words = f"({', '.join(map(str, shape))}){' with T >= 1' if 'T' in shape else ''}"
        message = f"{who}: expected shape {words}; received {received}"
        raise ValueError(message)
    infinite = torch.isinf(rows)
    if bool(infinite.any()):
        where = infinite.nonzero()[0].tolist()
        message = (
            f"{who}: expected finite numbers; received an infinite one at {where}; mark a missing component "
            f"with NaN"
        )
        raise ValueError(message)
    return rows


def checked_time(time: float, name: str) -> float:
    """Return a finite time; raises ValueError otherwise."""
    if not isinstance(time, int | float) or not math.isfinite(time):
        message = f"{name}: expected a finite number; received {time}"
        raise ValueError(message)
    return time


def checked_step(dt: Numbers) -> float:
    """Return the length of one step; raises the same errors as `checked_steps`."""
    return dt if _is_step(dt) else float(checked_steps(dt))


def _is_step(dt: Numbers) -> TypeIs[float]:
    return isinstance(dt, float) and 0.0 < dt < math.inf


def checked_steps(dt: Numbers, steps: int | None = None) -> Tensor:
    """Return the common step length (), or the lengths (T,) of T = `steps` steps, as float64.

    Raises:
        ValueError: wrong shape, or a length that is not finite or not positive.
    """
    if _is_step(dt):
        return torch.full((), dt, dtype=torch.float64)
    lengths = as_float64(dt, "dt")
    wrong = lengths[~((lengths > 0.0) & lengths.isfinite())]
    if len(wrong) > 0:
        message = f"dt: expected finite steps > 0; received {float(wrong[0])}"
        raise ValueError(message)
    if lengths.ndim > 0 and lengths.shape != (steps,):
        one = f"one number; received {described(dt)}"
        many = f"a number or shape ({steps},); received {tuple(lengths.shape)}"
        message = f"dt: expected {one if steps is None else many}"
        raise ValueError(message)
    return lengths
