"""Works measured in turn, A B A B, so that a slow spell of the machine meets all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

import torch

Work = Callable[[], object]


class Row(NamedTuple):
    """One piece of work: its name, CPU seconds of each repeat by who did it, and seconds of the floor."""

    name: str
    times: dict[str, list[float]]
    floor: list[float] | None


def in_turn(
    name: str,
    works: dict[str, Work],
    repeats: int,
    floor: Work | None = None,
    clock: Callable[[], float] = time.process_time,
) -> Row:
    """Return the seconds of all works and of the floor, in turn, after one call each to warm up.

    By default CPU seconds: all threads of the process count, so that nobody gains by a pool of them.
    """
    everything = works if floor is None else {**works, "floor": floor}
    times: dict[str, list[float]] = {key: [] for key in everything}
    for work in everything.values():
        work()
    for _ in range(repeats):
        for key, work in everything.items():
            begin = clock()
            work()
            times[key].append(clock() - begin)
    return Row(name, times, times.pop("floor", None))


def ratio(above: list[float], below: list[float]) -> float:
    """Return the median of the ratios of each repeat."""
    return median(a / b for a, b in zip(above, below, strict=True))


def products(batch: int, width: int, multiply_adds: float, dtype: torch.dtype) -> Work:
    """Return a floor: so many multiply-adds as products (batch, width) @ (width, width)."""
    left, right = torch.randn(batch, width, dtype=dtype), torch.randn(width, width, dtype=dtype)
    out = torch.empty_like(left)
    count = max(1, round(multiply_adds / (batch * width * width)))

    def work() -> None:
        for _ in range(count):
            torch.mm(left, right, out=out)

    return work


def settle() -> None:
    """Let the allocator keep the memory of small tensors, as it does once a data set was loaded."""
    large = torch.ones(8_000_000)
    del large
    torch.set_num_threads(1)
