"""From a graph of loss and gradients to C++ code by TorchInductor, kept on disk, and how long that takes."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import torch

from ahnn.contents import read_whole
from ahnn.files import write_cached
from ahnn.training.tracing import Traced

FOLDER = "compiled"
"""Of compiled code, in the folder of generated data."""
PLACE = "TORCHINDUCTOR_CACHE_DIR"
"""Environment variable by which a user puts compiled code elsewhere."""
PER_NODE = 0.15
"""Seconds of a compilation for each operation, before any was measured."""
RELOAD = 10.0
"""Seconds to load what is compiled, with the compiler's own modules."""


class Program(NamedTuple):
    """A compiled function of a batch and the tensors of a model.

    Attributes:
        call: (start, increments, dt if it is a tensor, parameters, buffers) -> loss and its gradients.
        touched: parameters that the loss depends on; the others have no gradient.
    """

    call: Callable[..., Any]
    touched: list[bool]


def compiled(traced: Traced, cache: Path) -> Program:
    """Return a graph as compiled code, which takes a while unless it is in the cache.

    Raises:
        Exception: of many types, where no compiler is found or the compilation fails.
    """
    from torch._inductor import config, standalone_compile

    # A pool of compilers would outlive the training; the cache compares settings, and not the threads.
    settings = {"compile_threads": 1, "cpp.threads": torch.get_num_threads()}
    known = record(traced, cache)
    began = time.perf_counter()
    with kept_in(place(cache)), torch.no_grad(), config.patch(settings):
        made = standalone_compile(traced.graph, [*traced.arguments], dynamic_shapes="from_example_inputs")
    if not known.exists():
        seconds = time.perf_counter() - began
        write_cached(known, json.dumps(seconds / len(traced.graph.graph.nodes)).encode())
    return Program(made, traced.touched)


def price(traced: Traced, cache: Path) -> float:
    """Return about how many seconds `compiled` takes, by what it took before on this machine."""
    known = record(traced, cache)
    if known.exists():
        return RELOAD
    found = sorted(_seconds(path) for path in known.parent.glob("*.json"))
    return len(traced.graph.graph.nodes) * (found[len(found) // 2] if found else PER_NODE)


def _seconds(path: Path) -> float:
    """Return the seconds for each operation of a graph that a file names."""
    try:
        return min(10.0, max(0.0, float(json.loads(read_whole(path)))))
    except (OSError, TypeError, ValueError):
        return PER_NODE


def record(traced: Traced, cache: Path) -> Path:
    """Return the file that says how long a graph took to compile."""
    shapes = [(t.shape, t.stride(), t.dtype) for t in traced.arguments]
    parts = (torch.__version__, torch.get_num_threads(), traced.graph.code, shapes)
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
    return place(cache) / "seconds" / f"{digest}.json"


def place(cache: Path) -> Path:
    """Return the folder of compiled code: in the cache unless the environment names another."""
    return Path(asked() or cache / FOLDER).expanduser()


def asked() -> str | None:
    """Return the folder that the user names; torch sets the variable to its own default as it is imported."""
    from torch._inductor.runtime.cache_dir_utils import default_cache_dir

    named = os.environ.get(PLACE)
    return named if named and named != default_cache_dir() else None


@contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """Keep compiled code in a folder.

    Raises:
        PermissionError: others can write there, whose code would be executed.
    """
    if asked():
        yield
        return
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    known = folder.stat()
    if hasattr(os, "getuid") and (
        known.st_uid != os.getuid() or known.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    ):
        message = f"{folder}: a folder of executable code that others can write. Set {PLACE} to another"
        raise PermissionError(message)
    before = os.environ.get(PLACE)
    os.environ[PLACE] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(PLACE)
        if before is not None:
            os.environ[PLACE] = before
