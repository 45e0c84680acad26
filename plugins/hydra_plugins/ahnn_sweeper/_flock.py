"""Journal file lock that is released when its holder dies.

Optuna's own lock is a symbolic link; a process killed while it holds one blocks all others for a grace
period of 30 s. The operating system releases this one at once.
"""

from __future__ import annotations

import fcntl
import os
import threading

from optuna.storages.journal import JournalFileOpenLock


class FileLock(JournalFileOpenLock):
    """Exclusive lock on `PATH.lock`, between processes and between threads.

    Args:
        path: protected file.
    """

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = path + ".lock"
        self._thread_lock = threading.Lock()
        self._descriptor = -1

    def acquire(self) -> bool:
        """Wait for and acquire the lock."""
        self._thread_lock.acquire()
        self._descriptor = os.open(self._path, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX)
        return True

    def release(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)
        self._thread_lock.release()
