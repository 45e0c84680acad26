"""Whether a request fits into memory or onto a disk, before it is made, and what becomes of freed memory."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from pathlib import Path

from ahnn.errors import UserError

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


def available() -> int:
    """Return the bytes of memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def require_memory(who: str, what: str, size: float) -> None:
    """Check an estimate of bytes against the memory of the machine.

    Args:
        who: the parameters that determine the size, for the message.
        what: of what size, for the message.
        size: bytes.

    Raises:
        UserError: it does not fit.
    """
    if size > available():
        message = (
            f"{who}: expected {what} that fit into {available() / 1e9:.0f} GB; received {size / 1e9:.3g} GB. "
            "Ask for less"
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
