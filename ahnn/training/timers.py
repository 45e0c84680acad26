"""Median durations of repeated calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import torch

ENOUGH = 0.25
"""Total duration of timed calls that suffices, in seconds: of longer ones only one is timed."""
SUMS, SUM = 5, 100_000
"""Number of timed sums, and of their terms."""


def median_seconds(work: Callable[[], Any], repeats: int = 1) -> float:
    """Return the median time of a function after a warm-up call."""
    times = []
    while len(times) < 2 or (len(times) <= repeats and sum(times[1:]) < ENOUGH):
        times.append(seconds_of(work))
    return median(times[1:])


def seconds_of(work: Callable[[], Any]) -> float:
    """Return the time of a call, including what it started on a GPU."""
    begin = time.perf_counter()
    work()
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
    return time.perf_counter() - begin


def sum_seconds() -> float:
    """Return the median time of a sum of squares in Python, the unit of other work in Python."""
    return median(seconds_of(lambda: sum(k * k for k in range(SUM))) for _ in range(SUMS))
