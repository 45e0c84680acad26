"""The heavy imports of a command: no signal cuts them, and nobody looks for garbage in them."""

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
    """Import what stays until the process ends, at the beginning of a command.

    Signals wait, as `held` says. Python's collector rests: it would go through all modules again and again.
    What is alive after the first such block is left out of every later collection, that of the exit too.
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
    """Let modules of the working directory be imported, behind all others, where the user names one of them.

    Args:
        targets: each `_target_` of a configuration that is the user's own, or that he trusts.
    """
    for target in targets:
        name, here = str(target).partition(".")[0], os.getcwd()
        unknown = name.isidentifier() and here not in sys.path and find_spec(name) is None
        if unknown and PathFinder.find_spec(name, [here]) is not None:
            sys.path.append(here)


def import_torchmetrics() -> None:
    """Import torchmetrics, which Lightning needs, without scipy.signal: that is a seventh of a short command.

    It imports scipy.signal only to look for a name of older versions there, for another package's sake.
    """
    if not {"scipy.signal", "torchmetrics"} & sys.modules.keys():
        stand_in = ModuleType("scipy.signal")
        setattr(stand_in, "hamming", None)  # noqa: B010 - no attribute that a type checker knows
        sys.modules["scipy.signal"] = stand_in
        try:
            import torchmetrics  # noqa: F401
        finally:
            del sys.modules["scipy.signal"]


@cache  # once: of several jobs in one process, the later find garbage of the earlier, which must go
def _leave_alone() -> None:
    gc.freeze()
