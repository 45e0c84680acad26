"""Commands in forked processes: nothing is imported again, and a kill is a kill."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

TRAINING = [
    "recipe=first_order",
    "evaluation=scores",
    "evaluation.figures=false",
    "system.steps=60",
    "data.trajectories=20",
    "data.windows_per_epoch=160",
    "data.val_windows=40",
    "data.batch_size=16",
    "model.network.width=8",
    "trainer.max_epochs=3",
    "trainer.accelerator=cpu",
    "plugins=none",
    "logger=none",
    "callbacks.last.every=4",
]
"""A training of three epochs of ten steps."""


class Child:
    """A forked process that does some work, with what it says in a file.

    Args:
        work: what it does.
        log: where its output goes.
    """

    def __init__(self, work: Callable[[], object], log: Path) -> None:
        self.log = log
        self.pid = os.fork()
        if not self.pid:
            os._exit(_done(work, log))

    def end(self, number: int = signal.SIGKILL, after: float = 0.0) -> None:
        """Send a signal after some seconds, where the process is still there."""
        time.sleep(after)
        if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            os.kill(self.pid, number)

    def code(self, limit: float = 120.0) -> int:
        """Wait and return the exit code, negative for a signal; a process that hangs is a failure."""
        until = time.monotonic() + limit
        while time.monotonic() < until:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.005)
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        raise AssertionError(f"no end after {limit} s; it said {self.said()[-200:]!r}")

    def said(self) -> str:
        """Return the output so far."""
        return self.log.read_text(errors="replace") if self.log.exists() else ""


def _done(work: Callable[[], object], log: Path) -> int:
    """Do the work with output into the file and return the exit code."""
    try:
        target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(target, number)
            setattr(sys, name, os.fdopen(number, "w", buffering=1, closefd=False, errors="replace"))
        work()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(bool(stop.code))
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def command(module: str, *words: str) -> Callable[[], None]:
    """Return the work of `python -m module words`."""

    def work() -> None:
        from importlib import import_module

        from hydra.core.global_hydra import GlobalHydra

        GlobalHydra.instance().clear()
        sys.argv = [module, *words]
        import_module(module).main()

    return work


def trained(folder: Path, *more: str, cache: Path | None = None, name: str = "log") -> Child:
    """Start a small training in a folder."""
    os.environ["AHNN_CACHE"] = str(cache or folder.parent / "cache")
    log = folder.parent / f"{folder.name}.{name}"
    return Child(command("ahnn.train", *TRAINING, f"run={folder}", *more), log)


def same_weights(one: Path, other: Path) -> None:
    """Assert that two runs have the same bits in their last and best weights."""
    import torch

    from ahnn.checkpoints import read_checkpoint

    for name in ("last.ckpt", "best.ckpt"):
        a, b = (read_checkpoint(run / "checkpoints" / name)["state_dict"] for run in (one, other))
        assert all(torch.equal(a[key], b[key]) for key in a), f"other weights in {name}"


def plain(text: str) -> None:
    """Assert that a message is one for a user."""
    start = text.find("Traceback")
    assert start < 0, f"{text[max(0, start - 80) : start + 300]} ... {text[-300:]}"
    assert "None:" not in text, text[-400:]
