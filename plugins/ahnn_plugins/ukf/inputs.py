"""Checks at the door of the filter, so that the loop can trust its inputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn_plugins.ukf.covariances import covariance_factor
from ahnn_plugins.ukf.measurements import Measurement
from ahnn_plugins.ukf.types import Belief, Form, ProcessNoise


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
    measurements: Tensor,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Tensor,
    dt: float | Tensor,
    form: Form,
    start_time: float,
) -> Inputs:
    """Return the inputs in the form that the loop uses; arguments as in `unscented_filter`.

    Raises:
        ValueError: as in `unscented_filter`.
    """
    batch, size = belief.mean.shape
    device = belief.mean.device
    width = len(measurement.names)
    _check_belief(belief)
    _check_measurements(measurements, batch, width)
    lengths, times = _grid(dt, measurements.shape[1], start_time)
    chol_r = covariance_factor(
        measurement_noise.to(device), "R", batch=batch, size=width, definite=form.needs_definite_noise
    )
    present = ~torch.isnan(measurements)
    return Inputs(
        measurements=measurements.to(torch.float64),
        present=present,
        is_measured=present.any(-1).any(0).tolist(),
        dt=lengths,
        times=times,
        chol_q=_process_factor(process_noise, batch, size, device),
        chol_r=chol_r.expand(batch, width, width),
    )


def _check_belief(belief: Belief) -> None:
    batch, size = belief.mean.shape
    if belief.chol.shape != (batch, size, size) or belief.mean.dtype != torch.float64:
        message = (
            f"unscented_filter: expected a float64 belief with mean (B, D) and chol (B, D, D), got "
            f"{belief.mean.dtype} {tuple(belief.mean.shape)} and {tuple(belief.chol.shape)}; "
            f"use initial_belief"
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


def _grid(dt: float | Tensor, steps: int, start_time: float) -> tuple[list[float], list[float]]:
    """Return the lengths of the steps, and the times at which they end."""
    if not isinstance(dt, Tensor) or dt.ndim == 0:
        length = float(dt)
        return [length] * steps, [start_time + length * (k + 1) for k in range(steps)]
    if dt.shape != (steps,):
        message = f"unscented_filter: expected dt a number or of shape ({steps},), got {tuple(dt.shape)}"
        raise ValueError(message)
    lengths = dt.to(torch.float64)
    return lengths.tolist(), (start_time + lengths.cumsum(0)).tolist()


def _process_factor(
    process_noise: ProcessNoise, batch: int, size: int, device: torch.device
) -> Callable[[float], Tensor]:
    """Return the factor of Q, (B, D, D), as a function of the step; each length is factored once."""

    def factor(matrix: Tensor) -> Tensor:
        chol = covariance_factor(matrix.to(device), "Q", batch=batch, size=size, definite=False)
        return chol.expand(batch, size, size)

    if isinstance(process_noise, Tensor):
        constant = factor(process_noise)
        return lambda _: constant
    known: dict[float, Tensor] = {}

    def of_step(dt: float) -> Tensor:
        if dt not in known:
            known[dt] = factor(process_noise(dt))
        return known[dt]

    return of_step
