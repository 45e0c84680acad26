"""Whether a request fits into memory or onto a disk, checked before anything is allocated."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from ahnn.errors import UserError


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
