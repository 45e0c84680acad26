"""Checks of available memory and disk space before allocation, and reuse of freed memory."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import sys
from pathlib import Path

from ahnn.errors import UserError

CGROUPS = {
    "": ("sys/fs/cgroup", "memory.max", "anon"),
    "memory": ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "total_rss"),
}
"""Files of control groups, versions 2 and 1, with the memory limit and the memory in use."""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Constants of glibc's malloc.h."""


def keep_freed() -> None:
    """Make the C library keep freed memory for reuse by later tensors.

    The system zeroes pages before it allocates them again, which took a fifth of the time of weak-form steps.
    Nothing changes if the user's environment tunes malloc, or if the C library is not glibc.
    """
    tuned = {"MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES"} & os.environ.keys()
    if sys.platform != "linux" or tuned:
        return
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(M_MMAP_THRESHOLD, 2**30)
        mallopt(M_TRIM_THRESHOLD, 2**31 - 1)


def available(root: Path = Path("/")) -> int:
    """Return the memory in bytes still available under the limits of machine and control groups.

    Args:
        root: root of the file system; without Linux's accounting files the machine's total memory is
            returned, or on Windows no limit.
    """
    limits = [sys.maxsize]
    with contextlib.suppress(AttributeError):  # Windows
        limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    with contextlib.suppress(OSError, KeyError, ValueError):
        limits = [1024 * _numbers(root / "proc/meminfo")["MemAvailable"]]
    with contextlib.suppress(OSError):
        for line in (root / "proc/self/cgroup").read_text().splitlines():
            _, kinds, place = line.split(":", 2)
            for kind, (base, name, taken) in CGROUPS.items():
                if kind in kinds.split(","):
                    group = root / base / place.lstrip("/")
                    limits += _left(group, root / base, name, taken)
    return max(0, min(limits))


def _left(group: Path, base: Path, name: str, taken: str) -> list[int]:
    """Return the memory left in a control group and its ancestors; groups without a limit are omitted."""
    found = []
    for folder in (group, *group.parents):
        with contextlib.suppress(OSError, KeyError, ValueError):  # for example `max`
            found.append(int((folder / name).read_text()) - _numbers(folder / "memory.stat")[taken])
        if folder == base:
            break
    return found


def _numbers(path: Path) -> dict[str, int]:
    """Return the first number in each line of a file, by the first word of the line."""
    rows = (line.replace(":", " ").split() for line in path.read_text().splitlines())
    return {name: int(value) for name, value, *_ in rows}


def require_memory(who: str, what: str, size: float, remedy: str = "Reduce it") -> None:
    """Compare an estimate in bytes with the available memory.

    Args:
        who: the parameters that determine the size, for the message.
        what: description of the data, for the message.
        size: estimate in bytes.
        remedy: remedy in the message.

    Raises:
        UserError: the estimate exceeds the available memory.
    """
    if size > (left := available()):
        message = (
            f"{who}: expected {what} that fit in {left / 1e9:.3g} GB of available memory; received "
            f"{size / 1e9:.3g} GB. {remedy}"
        )
        raise UserError(message)


def require_disk(who: str, what: str, size: float, folder: Path) -> None:
    """Compare an estimate in bytes with the free disk space of a folder, which need not exist yet.

    Args:
        who: the parameters that determine the size, for the message.
        what: description of the data, for the message.
        size: estimate in bytes.
        folder: output folder.

    Raises:
        UserError: the estimate exceeds the free space.
    """
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(there).free
    if size > free:
        message = (
            f"{who}: expected {what} that fit in the {free / 1e9:.0f} GB free at {folder}; received "
            f"{size / 1e9:.3g} GB. Reduce it, or choose another disk with AHNN_CACHE"
        )
        raise UserError(message)
