"""Parallel execution of a computation in parts, on the cores available to the process.

The division depends only on the work, and each part runs in one thread: results are bitwise identical on any
number of cores, and a run resumed elsewhere is unchanged. Threads inside an operation guarantee neither,
and on shared cores they wait for each other in busy loops.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import torch

P = TypeVar("P")
T = TypeVar("T")


def cores() -> int:
    """Return the number of parts that may run in parallel.

    It is the number of cores on which the process may be scheduled, at most OMP_NUM_THREADS, divided by the
    number of threads of a torch operation.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity else os.cpu_count() or 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    if limit.isdecimal() and int(limit) > 0:
        count = min(count, int(limit))
    return max(1, count // torch.get_num_threads())


def each(work: Callable[[P], T], parts: Iterable[P], device: torch.device) -> list[T]:
    """Apply a function to each part, without gradients, and return the results in order.

    Parts run sequentially on devices other than the CPU, and inside a worker thread.
    """
    given = list(parts)
    alone = device.type != "cpu" or threading.current_thread() is not threading.main_thread()
    if alone or len(given) < 2 or cores() < 2:
        with torch.no_grad():
            return [work(part) for part in given]
    return list(_pool(cores()).map(torch.no_grad()(work), given))


def slices(count: int, size: int, device: torch.device | None = None) -> list[slice]:
    """Return slices of `size` rows each, the last possibly shorter; one empty slice for zero rows.

    Other devices use a single slice, since a GPU schedules its own blocks.
    """
    if device is not None and device.type != "cpu":
        return [slice(0, count)]
    return [slice(first, min(first + size, count)) for first in range(0, max(1, count), size)]


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="ahnn")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork
