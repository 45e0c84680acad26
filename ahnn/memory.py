"""Whether a request fits into memory or onto a disk, before it is made, and what becomes of freed memory."""

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
"""Where control groups of version 2, and of version 1, say what memory they may take, and what is taken."""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names of glibc's malloc.h."""


def keep_freed() -> None:
    """Let the C library keep the memory of tensors that are gone, for those that come.

    Pages given back come again full of zeros, which took a fifth of the time of steps in the weak form.
    Nothing is done where the user's environment tunes malloc, or where the C library is another than glibc.
    """
    tuned = {"MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES"} & os.environ.keys()
    if sys.platform != "linux" or tuned:
        return
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(M_MMAP_THRESHOLD, 2**30)
        mallopt(M_TRIM_THRESHOLD, 2**31 - 1)


def available(root: Path = Path("/")) -> int:
    """Return the bytes of memory that this process may still take: of the machine, and of its control groups.

    Args:
        root: of the file system; where it lacks Linux's accounts, all memory of the machine counts.
    """
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
    """Return what a control group and each one around it have left; those without a limit have no entry."""
    found = []
    for folder in (group, *group.parents):
        with contextlib.suppress(OSError, KeyError, ValueError):  # such as `max`
            found.append(int((folder / name).read_text()) - _numbers(folder / "memory.stat")[taken])
        if folder == base:
            break
    return found


def _numbers(path: Path) -> dict[str, int]:
    """Return the first number of each line of a file, by its name."""
    rows = (line.replace(":", " ").split() for line in path.read_text().splitlines())
    return {name: int(value) for name, value, *_ in rows}


def require_memory(who: str, what: str, size: float, remedy: str = "Ask for less") -> None:
    """Check an estimate of bytes against the memory that is left.

    Args:
        who: the parameters that determine the size, for the message.
        what: of what size, for the message.
        size: bytes.
        remedy: for the message.

    Raises:
        UserError: it does not fit.
    """
    if size > (left := available()):
        message = (
            f"{who}: expected {what} that fit into the {left / 1e9:.3g} GB of memory that are left; received "
            f"{size / 1e9:.3g} GB. {remedy}"
        )
        raise UserError(message)


def require_disk(who: str, what: str, size: float, folder: Path) -> None:
    """Check an estimate of bytes against what is free on the disk of a folder, which need not exist yet.

    Args:
        who: the parameters that determine the size, for the message.
        what: of what size, for the message.
        size: bytes.
        folder: where it is to be written.

    Raises:
        UserError: it does not fit.
    """
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(there).free
    if size > free:
        message = (
            f"{who}: expected {what} that fit into {free / 1e9:.0f} GB, free at {folder}; received "
            f"{size / 1e9:.3g} GB. Ask for less, or choose another disk with AHNN_CACHE"
        )
        raise UserError(message)
