"""Locks on open files, which the operating system releases when the process ends for any reason."""

from __future__ import annotations

import contextlib
import os
import time
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

FAR = 2**31 - 2
"""Offset of the byte locked on Windows: beyond our files, since others cannot read a locked byte."""


def lock(file: IO[Any], *, wait: bool = True) -> None:
    """Lock an open file against other processes until it is closed.

    Raises:
        BlockingIOError: another process has locked it, and `wait` is false.
        OSError: the file system has no locks.
    """
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return
    import msvcrt

    windows: Any = msvcrt  # type checkers on other systems do not know its contents
    descriptor = file.fileno()
    place = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        while True:
            os.lseek(descriptor, FAR, os.SEEK_SET)
            with contextlib.suppress(PermissionError):
                windows.locking(descriptor, windows.LK_NBLCK, 1)
                return
            if not wait:
                raise BlockingIOError
            time.sleep(0.02)
    finally:
        os.lseek(descriptor, place, os.SEEK_SET)
