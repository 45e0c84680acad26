"""Lock of a journal file that ends with its holder.

Optuna's own lock is a symbolic link; a process killed while it holds one blocks all others for a grace
period of 30 s. The operating system releases this one at once.
"""

from __future__ import annotations

import fcntl
import os
import threading

from optuna.storages.journal import JournalFileOpenLock


class FileLock(JournalFileOpenLock):
    """Exclusive lock on `PATH.lock`, for the processes and for the threads of this process.

    Args:
        path: the file that is protected.
    """

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = path + ".lock"
        self._thread_lock = threading.Lock()
        self._descriptor = -1

    def acquire(self) -> bool:
        """Wait for the lock and take it."""
        self._thread_lock.acquire()
        self._descriptor = os.open(self._path, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX)
        return True

    def release(self) -> None:
        """Give the lock back."""
        os.close(self._descriptor)
        self._thread_lock.release()
