"""Checks at the door of the filter, so that the loop can trust its inputs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import covariance_factor
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers, as_float64, described
from ahnn_plugins.ukf.types import Form, ProcessNoise


class Inputs(NamedTuple):
    """Inputs of the filter, checked.

    Attributes:
        measurements: (B, T, M) float64, NaN where missing.
        present: (B, T, M) bool.
        is_measured: T entries, whether any member has anything in that row.
        dt: T step lengths.
        times: T times, at the end of each step.
        chol_q: function of the step's length that returns the factor (B, D, D) of Q.
        chol_r: (B, M, M) factor of R.
    """

    measurements: Tensor
    present: Tensor
    is_measured: list[bool]
    dt: list[float]
    times: list[float]
    chol_q: Callable[[float], Tensor]
    chol_r: Tensor


def checked_inputs(
    belief: Belief,
    measurements: Numbers,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Numbers,
    dt: Numbers,
    form: Form,
    start_time: float,
) -> Inputs:
    """Return the inputs in the form that the loop uses; arguments as in `unscented_filter`.

    Raises:
        ValueError: as in `unscented_filter`.
    """
    _check_parts(belief, measurement, form)
    _check_belief(belief)
    batch, size = belief.mean.shape
    device = belief.mean.device
    width = len(measurement.names)
    rows = as_float64(measurements, "unscented_filter: measurements", device)
    _check_measurements(rows, batch, width)
    lengths, times = _grid(dt, rows.shape[1], start_time)
    chol_r = covariance_factor(
        measurement_noise, "R", batch=batch, size=width, definite=form.needs_definite_noise
    ).to(device)
    present = ~torch.isnan(rows)
    return Inputs(
        measurements=rows,
        present=present,
        is_measured=present.any(-1).any(0).tolist(),
        dt=lengths,
        times=times,
        chol_q=_process_factor(process_noise, batch, size, device),
        chol_r=chol_r.expand(batch, width, width),
    )


def _check_parts(belief: Belief, measurement: Measurement, form: Form) -> None:
    """Refuse arguments that are something else than the loop calls."""
    missing = [name for name in ("names", "residual", "__call__") if not hasattr(measurement, name)]
    if not isinstance(belief, Belief):
        expected, received = "a Belief", f"{described(belief)}; use initial_belief"
    elif missing:
        expected = "a measurement model with names, residual and a call (x, t)"
        received = f"{measurement!r} without {', '.join(missing)}; see Measurement"
    elif not isinstance(form, Form):
        expected, received = "a Form, SQUARE_ROOT or STANDARD", repr(form)
    else:
        return
    message = f"unscented_filter: expected {expected}, got {received}"
    raise ValueError(message)


def _check_belief(belief: Belief) -> None:
    mean, chol = belief
    right = mean.ndim == 2 and len(mean) > 0 and chol.shape == (*mean.shape, mean.shape[1])
    if not right or mean.dtype != torch.float64 or chol.dtype != torch.float64:
        message = (
            f"unscented_filter: expected a float64 belief with mean (B, D), B >= 1, and chol (B, D, D), got "
            f"{mean.dtype} {tuple(mean.shape)} and {chol.dtype} {tuple(chol.shape)}; use initial_belief"
        )
        raise ValueError(message)


def _check_measurements(measurements: Tensor, batch: int, width: int) -> None:
    shape = tuple(measurements.shape)
    if measurements.ndim != 3 or shape[0] != batch or shape[2] != width or shape[1] == 0:
        message = f"unscented_filter: expected measurements ({batch}, T, {width}) with T >= 1, got {shape}"
        raise ValueError(message)
    infinite = torch.isinf(measurements)
    if bool(infinite.any()):
        b, k, m = (int(n) for n in infinite.nonzero()[0])
        message = (
            f"unscented_filter: expected finite measurements, got an infinite one at [{b}, {k}, {m}]; "
            f"mark a missing component with NaN"
        )
        raise ValueError(message)


def _grid(dt: Numbers, steps: int, start_time: float) -> tuple[list[float], list[float]]:
    """Return the lengths of the steps, and the times at which they end."""
    if not math.isfinite(start_time):
        message = f"unscented_filter: expected a finite start_time, got {start_time}"
        raise ValueError(message)
    lengths = as_float64(dt, "unscented_filter: dt")
    if lengths.ndim > 0 and lengths.shape != (steps,):
        message = f"unscented_filter: expected dt a number or of shape ({steps},), got {tuple(lengths.shape)}"
        raise ValueError(message)
    wrong = lengths[~((lengths > 0.0) & lengths.isfinite())]
    if len(wrong) > 0:
        message = f"unscented_filter: expected finite steps dt > 0, got {float(wrong[0])}"
        raise ValueError(message)
    if lengths.ndim == 0:
        length = float(lengths)
        return [length] * steps, [start_time + length * (k + 1) for k in range(steps)]
    return lengths.tolist(), (start_time + lengths.cumsum(0)).tolist()


def _process_factor(
    process_noise: ProcessNoise, batch: int, size: int, device: torch.device
) -> Callable[[float], Tensor]:
    """Return the factor of Q, (B, D, D), as a function of the step; each length is factored once."""

    def factor(matrix: Numbers) -> Tensor:
        chol = covariance_factor(matrix, "Q", batch=batch, size=size, definite=False)
        return chol.to(device).expand(batch, size, size)

    if not callable(process_noise):
        constant = factor(process_noise)
        return lambda _: constant
    known: dict[float, Tensor] = {}

    def of_step(dt: float) -> Tensor:
        if dt not in known:
            known[dt] = factor(process_noise(dt))
        return known[dt]

    return of_step
