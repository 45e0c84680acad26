"""Heavy imports of a command, without interruption by signals or garbage collection."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec
from types import ModuleType

from ahnn.cli.early_stops import held


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """Import long-lived modules at the beginning of a command.

    Signals are deferred, see `held`. Garbage collection is disabled, since it would repeatedly traverse all
    modules. Objects alive after the first such block are excluded from later collections, including that at
    exit.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with held():
            yield
        _leave_alone()
    finally:
        if collects:
            gc.enable()


def let_import(targets: Iterable[object]) -> None:
    """Allow imports from the working directory, after all other paths, if the user names such a module.

    Args:
        targets: each `_target_` of a configuration written or trusted by the user.
    """
    for target in targets:
        name, here = str(target).partition(".")[0], os.getcwd()
        unknown = name.isidentifier() and here not in sys.path and find_spec(name) is None
        if unknown and PathFinder.find_spec(name, [here]) is not None:
            sys.path.append(here)


def import_torchmetrics() -> None:
    """Import torchmetrics, which Lightning needs, without scipy.signal.

    That import would take a seventh of a short command's time, only to check for a name of older versions.
    """
    if not {"scipy.signal", "torchmetrics"} & sys.modules.keys():
        stand_in = ModuleType("scipy.signal")
        setattr(stand_in, "hamming", None)  # noqa: B010 - attribute unknown to type checkers
        sys.modules["scipy.signal"] = stand_in
        try:
            import torchmetrics  # noqa: F401
        finally:
            del sys.modules["scipy.signal"]


@cache  # only once: later jobs of a process must collect the garbage of earlier ones
def _leave_alone() -> None:
    gc.freeze()
