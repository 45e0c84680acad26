"""Generated trajectories on disk: one file per content hash, written atomically, verified on load.

Files are in the safetensors format: reading one never executes anything.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from filelock import FileLock
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from ahnn.files import require_writable, write_atomically
from ahnn.systems import System
from ahnn.types import Trajectories

log = logging.getLogger(__name__)

FORMAT = 3
"""Raise this number when the meaning of a stored file changes, for example after a fix of the generator."""


def recipe(system: System, count: int, seed: int) -> dict[str, Any]:
    """Return everything that determines a data set, as plain values."""
    kind = type(system)
    known = {
        "system": f"{kind.__module__}.{kind.__qualname__}",
        "parameters": system.parameters(),
        "integrator": system.integrator,
        "count": count,
        "seed": seed,
    }
    return known | ({"code": code} if (code := source_of(kind)) else {})


def source_of(kind: type) -> dict[str, str]:
    """Return the hashes of the modules that define a system and its bases; those of ahnn go by `FORMAT`.

    A module, and not the class alone: a force may call what stands beside it.
    """
    modules = {base.__module__ for base in kind.__mro__} - {"builtins", "abc"}
    return {
        name: hashlib.sha256(_source(name, kind).encode()).hexdigest()[:16]
        for name in sorted(modules)
        if name.partition(".")[0] != "ahnn"
    }


def _source(name: str, kind: type) -> str:
    """Return the source of a module; of one without, that of the class, or else its bytecode."""
    for place in (sys.modules.get(name), kind):
        with contextlib.suppress(OSError, TypeError):
            return inspect.getsource(place)  # pyright: ignore[reportArgumentType]
    return repr([getattr(f, "__code__", None) and f.__code__.co_code for f in vars(kind).values()])


def load_or_make(folder: Path, wanted: dict[str, object], make: Callable[[], Trajectories]) -> Trajectories:
    """Return the stored trajectories of a recipe, made and stored first when missing or damaged.

    Of several processes that miss the same data, one makes it and the others wait.

    Raises:
        UserError: the folder cannot be written.
    """
    key = hashlib.sha256(json.dumps({"format": FORMAT, **wanted}, sort_keys=True).encode()).hexdigest()[:16]
    path = folder / f"{key}.safetensors"
    stored = stored_in(path)
    if stored is not None:
        return stored
    require_writable(folder)
    with FileLock(folder / ".lock"):
        stored = stored_in(path)
        if stored is None:
            stored = make()
            write(path, stored, wanted)
    return stored


def stored_in(path: Path) -> Trajectories | None:
    """Return the trajectories in a file, or None where it is missing or damaged."""
    if not path.exists():
        return None
    try:
        return read(path)
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        log.warning("data: %s is damaged (%s); it is generated again", path, error)
        return None


def write(path: Path, trajectories: Trajectories, made_from: dict[str, object]) -> None:
    """Write trajectories with their recipe and a checksum; the file appears whole or not at all."""
    metadata = {"recipe": json.dumps(made_from, sort_keys=True), "sha256": checksum(trajectories)}
    content = save({"states": trajectories.states, "times": shared_times(trajectories)}, metadata)
    write_atomically(path, content)


def read(path: Path) -> Trajectories:
    """Read trajectories and verify their checksum.

    Raises:
        ValueError: the checksum does not match.
    """
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        states, times = file.get_tensor("states"), file.get_tensor("times")
    trajectories = Trajectories(states, times.expand(states.shape[:2]))
    if checksum(trajectories) != metadata["sha256"]:
        message = "checksum mismatch"
        raise ValueError(message)
    return trajectories


def checksum(trajectories: Trajectories) -> str:
    """Return the SHA-256 of the times and the states."""
    digest = hashlib.sha256()
    for tensor in (shared_times(trajectories), trajectories.states):
        digest.update(tensor.contiguous().numpy().data)
    return digest.hexdigest()


def shared_times(trajectories: Trajectories) -> Tensor:
    """Return the times (B, T), or one row of them, (1, T), where all trajectories have the same."""
    times = trajectories.times
    shared = times.stride(0) == 0 or bool((times == times[:1]).all())
    return times[:1].contiguous() if shared else times.contiguous()
