"""Journal file lock that is released when its holder dies.

Optuna's own lock is a symbolic link; a process killed while it holds one blocks all other processes for a
grace period of 30 s. The operating system releases this lock immediately.
"""

from __future__ import annotations

import threading
from pathlib import Path
from typing import IO, Any

from optuna.storages.journal import JournalFileOpenLock

from ahnn.locks import lock


class FileLock(JournalFileOpenLock):
    """Exclusive lock on `PATH.lock`, between processes and between threads.

    Args:
        path: protected file.
    """

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = Path(path + ".lock")
        self._thread_lock = threading.Lock()
        self._file: IO[Any] | None = None

    def acquire(self) -> bool:
        """Wait for and acquire the lock."""
        self._thread_lock.acquire()
        self._file = self._path.open("ab")
        lock(self._file)
        return True

    def release(self) -> None:
        """Release the lock."""
        assert self._file is not None
        self._file.close()
        self._thread_lock.release()
