"""Measurement schedules: every k-th step, or given times."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.numbers import Numbers, as_float64
from ahnn.substeps import substeps_of_each


def every(measurements: Numbers, k: int) -> Tensor:
    """Return measurements (B, T, M) with all but every k-th row set to NaN.

    Row i is measured after step i + 1, so the rows kept are k - 1, 2 k - 1, ... (the paper: k = 60).

    Raises:
        ValueError: k is not a positive integer, or measurements are not (B, T, M).
    """
    # The remainder of NaN is NaN, so NaN is rejected too.
    if k < 1 or k % 1 != 0:
        message = f"every: expected a whole number of steps, at least 1; received {k}"
        raise ValueError(message)
    rows = _rows(measurements, "every")
    step = torch.arange(1, rows.shape[1] + 1, device=rows.device)
    return torch.where((step % k == 0)[:, None], rows, torch.nan)


class Schedule(NamedTuple):
    """Time steps that end on every measurement.

    Attributes:
        dt: (T,) lengths of the steps.
        measurements: (B, T, M), NaN at steps without a measurement.
    """

    dt: Tensor
    measurements: Tensor


def schedule(times: Numbers, measurements: Numbers, max_step: float, start_time: float = 0.0) -> Schedule:
    """Return steps of at most max_step that hit each of the K measurement times.

    Each gap is divided into equal steps. A measurement at the start time is rejected: update a recursive
    estimator with it before its first prediction.

    Args:
        times: (K,) increasing measurement times after the start.
        measurements: (B, K, M) measurements.
        max_step: maximum step of the flow.
        start_time: time of the initial belief.

    Raises:
        ValueError: times are not (K,), finite and increasing from the start, K is zero or differs from that
            of the measurements, or max_step is not positive.
    """
    given, ends = _rows(measurements, "schedule"), as_float64(times, "schedule: times")
    if ends.ndim != 1 or len(ends) == 0 or given.shape[1] != len(ends):
        message = (
            f"schedule: expected times (K,) with K >= 1 and measurements (B, K, M); received "
            f"{tuple(ends.shape)} and {tuple(given.shape)}"
        )
        raise ValueError(message)
    gaps = torch.diff(ends, prepend=ends.new_tensor([start_time]))
    if not bool(((gaps > 0.0) & gaps.isfinite()).all()) or not max_step > 0.0:
        message = (
            f"schedule: expected times increasing from {start_time:g} and max_step > 0; received "
            f"smallest gap {float(gaps.min()):g} and max_step {max_step:g}"
        )
        raise ValueError(message)
    counts = substeps_of_each(gaps, max_step)
    batch, _, size = given.shape
    rows = given.new_full((batch, int(counts.sum()), size), torch.nan)
    rows[:, counts.cumsum(0) - 1] = given
    return Schedule(torch.repeat_interleave(gaps / counts, counts), rows)


def _rows(measurements: Numbers, who: str) -> Tensor:
    """Return measurements (B, T, M) as float64."""
    rows = as_float64(measurements, f"{who}: measurements")
    if rows.ndim != 3:
        message = f"{who}: expected measurements (B, T, M); received {tuple(rows.shape)}"
        raise ValueError(message)
    return rows
