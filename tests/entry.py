"""Running the entry points inside the test process, and callbacks that cut a training short."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from lightning import Callback

SMALL = [
    "system.steps=60",
    "data.trajectories=20",
    "data.windows_per_epoch=160",
    "data.val_windows=40",
    "data.batch_size=16",
    "model.network.width=8",
    "trainer.max_epochs=3",
    "plugins=none",
    "trainer.accelerator=cpu",
    "logger=none",
]
"""Overrides of a training of 3 epochs of 10 steps, on the spring."""
FIRST = [*SMALL, "recipe=first_order", "evaluation=scores"]
"""The same by a first-order optimiser and without figures, where neither is what a test is about."""


class Interrupted(Exception):
    """A training was cut."""


class CutAfter(Callback):
    """Ends a training after a number of optimiser steps.

    Args:
        steps: optimiser steps that are taken.
        validation: cut when the validation after these steps begins, and not at once.
        kill: send SIGKILL to this process instead of raising.
        ctrl_c: raise what Ctrl-C raises.
    """

    def __init__(
        self, steps: int, validation: bool = False, kill: bool = False, ctrl_c: bool = False
    ) -> None:
        self.steps, self.validation, self.kill, self.ctrl_c = steps, validation, kill, ctrl_c

    def on_train_batch_end(self, trainer, *_) -> None:
        if not self.validation:
            self._cut(trainer)

    def on_validation_start(self, trainer, _) -> None:
        if self.validation:
            self._cut(trainer)

    def _cut(self, trainer) -> None:
        if trainer.global_step != self.steps:
            return
        if self.kill:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.ctrl_c:
            raise KeyboardInterrupt
        raise Interrupted


class SpoilAfter(Callback):
    """Makes the weights infinite after a number of optimiser steps."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def on_train_batch_end(self, trainer, pl_module, *_) -> None:
        if trainer.global_step == self.steps:
            with torch.no_grad():
                next(pl_module.parameters()).fill_(torch.inf)


@contextmanager
def untouched() -> Iterator[None]:
    """Restore what an entry point changes in its process: logging, Hydra, threads, environment, signals."""
    root = logging.getLogger()
    before = root.handlers[:], root.level
    lightning = logging.getLogger("lightning.pytorch").level
    interrupt = signal.getsignal(signal.SIGINT)
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setenv("HYDRA_FULL_ERROR", "0")
        try:
            yield
        finally:
            root.handlers[:], root.level = before
            signal.signal(signal.SIGINT, interrupt)
            logging.getLogger("ahnn").setLevel(logging.NOTSET)
            logging.getLogger("lightning.pytorch").setLevel(lightning)
            GlobalHydra.instance().clear()
            torch.set_num_threads(1)


def call(module: str, *arguments: str) -> int:
    """Return the exit code of `python -m module arguments`, run in this process."""
    from importlib import import_module

    main = import_module(module).main
    with untouched(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [module, *arguments])
        with pytest.raises(SystemExit) as stopped:
            main()
    return int(stopped.value.code or 0)


def forked(module: str, *arguments: str, before: Callable[[], object] = tuple) -> int:
    """Start `python -m module arguments` in a copy of this process, with its imports; return its id.

    The copy calls `before` first.
    """
    process = os.fork()
    if process == 0:
        with suppress(BaseException):
            before()
            os._exit(call(module, *arguments))
        os._exit(1)
    return process


def started(folder: Path, *overrides: str) -> subprocess.Popen:
    """A training in a process of its own, which hears signals even where the tests run under nohup."""
    command = [sys.executable, "-m", "ahnn.train", *overrides]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        command,
        cwd=folder,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=hear,
    )


def hear() -> None:
    """Let signals end this process, also where the tests run under nohup."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
