"""Parts of a computation side by side, on the cores that the process may use.

The parts belong to the work, and each is the work of one thread: results have the same bits on any number of
cores, and a training that goes on elsewhere stays the same. Threads inside an operation offer neither, and
where others share the cores they wait for each other in busy loops.
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
    """Return how many parts may run side by side.

    They are the cores that the process may be scheduled on, no more than OMP_NUM_THREADS says, shared among
    the threads that an operation of torch takes.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity else os.cpu_count() or 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    if limit.isdecimal() and int(limit) > 0:
        count = min(count, int(limit))
    return max(1, count // torch.get_num_threads())


def each(work: Callable[[P], T], parts: Iterable[P], device: torch.device) -> list[T]:
    """Return what the work makes of each part, in their order and without gradients.

    Parts of other devices than the CPU, or of a thread that is one of several, run one after the other.
    """
    given = list(parts)
    alone = device.type != "cpu" or threading.current_thread() is not threading.main_thread()
    if alone or len(given) < 2 or cores() < 2:
        with torch.no_grad():
            return [work(part) for part in given]
    return list(_pool(cores()).map(torch.no_grad()(work), given))


def slices(count: int, size: int, device: torch.device | None = None) -> list[slice]:
    """Return parts of so many rows, `size` in each or, in the last, fewer; of none, one without rows.

    What is not on the CPU is one part: the parts of a GPU are its own.
    """
    if device is not None and device.type != "cpu":
        return [slice(0, count)]
    return [slice(first, min(first + size, count)) for first in range(0, max(1, count), size)]


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="ahnn")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork
