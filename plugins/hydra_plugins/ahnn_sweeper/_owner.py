"""Ownership of trials, and liveness of their processes.

A trial records the process that requested it (`asked_by`) and, once its job has started, the process of the
job (`run_by`), each as host, process id and start time. On the same host the process table shows whether the
process exists, and its start time reveals a reused process id. For other hosts, and on Windows, a lease is
used: the owner writes the time (`lease`) every `RENEW` seconds, and a lease older than `EXPIRY` means that
the owner has died. The clocks of all machines must therefore agree to within a minute.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optuna.storages import BaseStorage
    from optuna.trial import FrozenTrial

RENEW = 30.0
EXPIRY = 150.0
logger = logging.getLogger(__name__)


def this_process() -> str:
    """Return `host|pid|start time` of this process and the time of the claim."""
    return f"{_host()}|{os.getpid()}|{_start_time(os.getpid())}|{time.time():.0f}"


def is_alive(trial: FrozenTrial) -> bool:
    """Return whether the process that works on a RUNNING trial still exists.

    A trial without any owner was interrupted during allotment. The caller holds the storage's lock, so no
    allotment is in progress, and the trial is an orphan.
    """
    owner = trial.user_attrs.get("run_by") or trial.user_attrs.get("asked_by")
    if owner is None:
        return False
    host, pid, start, claimed = owner.split("|")
    if host == _host() and start:
        return _start_time(int(pid)) == start
    renewed = max(float(claimed), trial.user_attrs.get("lease", 0.0))
    return time.time() - renewed < EXPIRY


def runs_elsewhere(trial: FrozenTrial) -> bool:
    """Return whether the job of a RUNNING trial runs in another process."""
    runner = trial.user_attrs.get("run_by", "")
    ours = this_process().rpartition("|")[0]
    return runner != "" and runner.rpartition("|")[0] != ours and is_alive(trial)


class Lease:
    """Renew the lease of some trials in the background, as a context.

    Args:
        storage: storage of the trials.
        trial_ids: ids of the trials; finished ones are ignored.
    """

    def __init__(self, storage: BaseStorage, trial_ids: Iterable[int]) -> None:
        self._storage = storage
        self._trial_ids = list(trial_ids)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._renew, name="trial-lease", daemon=True)

    def __enter__(self) -> Lease:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _renew(self) -> None:
        while not self._stop.wait(RENEW):
            for trial_id in self._trial_ids:
                try:
                    self._storage.set_trial_user_attr(trial_id, "lease", time.time())
                except Exception as error:  # finished trial, or unreachable database
                    logger.debug("lease of trial id %s not renewed: %s", trial_id, error)


def _host() -> str:
    """Return the host and, if any, the process-id namespace: containers may share a host name."""
    try:
        return f"{socket.gethostname()}/{os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()


def _start_time(pid: int) -> str:
    """Return when a process started, in the kernel's ticks; empty if it is gone or a zombie."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            fields = file.read().rpartition(")")[2].split()
    except FileNotFoundError:
        return "" if os.path.isdir("/proc/self") else _signalled(pid)
    return "" if fields[0] == "Z" else fields[19]


def _signalled(pid: int) -> str:
    """Return `alive` or "", on systems without /proc; always "" on Windows, where signal 0 interrupts."""
    if sys.platform == "win32":
        return ""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return ""
    except PermissionError:
        return "alive"
    return "alive"
