"""When measurements come: every k-th step, or at times of their own."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


def every(measurements: Tensor, k: int) -> Tensor:
    """Return the measurements (B, T, M) with all but each k-th row set to NaN.

    Row i is measured after step i + 1, so that the rows kept are k - 1, 2 k - 1, ... (the paper: k = 60).

    Raises:
        ValueError: if k is not positive.
    """
    if k < 1:
        message = f"every: expected a cadence of at least 1 step, got {k}"
        raise ValueError(message)
    step = torch.arange(1, measurements.shape[1] + 1, device=measurements.device)
    return torch.where((step % k == 0)[:, None], measurements, torch.nan)


class Schedule(NamedTuple):
    """Time steps that end on every measurement.

    Attributes:
        dt: (T,) lengths of the steps.
        measurements: (B, T, M), NaN in the steps between.
    """

    dt: Tensor
    measurements: Tensor


def schedule(times: Tensor, measurements: Tensor, max_step: float, start_time: float = 0.0) -> Schedule:
    """Return steps of at most max_step that hit each of the K measurement times.

    Each gap is cut into equal steps. A measurement at the start time itself needs a step of its own and is
    refused: update the initial belief instead.

    Args:
        times: (K,) increasing, later than the start.
        measurements: (B, K, M).
        max_step: longest step that the flow may take.
        start_time: time of the initial belief.

    Raises:
        ValueError: if times are not increasing from the start, or K differs.
    """
    if measurements.shape[1] != len(times):
        message = f"schedule: expected measurements (B, {len(times)}, M), got {tuple(measurements.shape)}"
        raise ValueError(message)
    gaps = torch.diff(times.to(torch.float64), prepend=torch.tensor([start_time], dtype=torch.float64))
    if not bool((gaps > 0.0).all()) or max_step <= 0.0:
        message = (
            f"schedule: expected times increasing from {start_time:g} and max_step > 0, got smallest gap "
            f"{float(gaps.min()):g} and max_step {max_step:g}"
        )
        raise ValueError(message)
    # A gap of 60.000000000000007 is one step of 60, not two of 30.
    counts = torch.ceil(gaps / max_step - 1e-9).clamp(min=1.0).to(torch.int64)
    batch, _, size = measurements.shape
    rows = measurements.new_full((batch, int(counts.sum()), size), torch.nan)
    rows[:, counts.cumsum(0) - 1] = measurements
    return Schedule(torch.repeat_interleave(gaps / counts, counts), rows)
