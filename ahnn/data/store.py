"""Generated trajectories on disk: one file per content hash, written atomically, verified on load.

Files are in the safetensors format: reading one never executes anything.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import logging
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.systems import System
from ahnn.types import Trajectories

log = logging.getLogger(__name__)

FORMAT = 2
"""Raise this number when the meaning of a stored file changes, for example after a fix of the generator."""


def recipe(system: System, count: int, seed: int) -> dict[str, object]:
    """Return everything that determines a data set, as plain values."""
    return {
        "format": FORMAT,
        "system": type(system).__name__,
        "parameters": asdict(system),
        "integrator": system.integrator,
        "count": count,
        "seed": seed,
    }


def load_or_make(folder: Path, wanted: dict[str, object], make: Callable[[], Trajectories]) -> Trajectories:
    """Return the stored trajectories of a recipe, made and stored first when missing or damaged.

    Of several processes that miss the same data, one makes it and the others wait.

    Raises:
        UserError: the folder cannot be written.
    """
    key = hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()[:16]
    path = folder / f"{key}.safetensors"
    stored = stored_in(path)
    if stored is not None:
        return stored
    require_writable(folder)
    with locked(folder):
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


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder's lock, which ends with its process; it keeps nobody out who does not ask for it."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks: work may be done twice
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def write(path: Path, trajectories: Trajectories, made_from: dict[str, object]) -> None:
    """Write trajectories with their recipe and a checksum; the file appears whole or not at all."""
    metadata = {
        "recipe": json.dumps(made_from, sort_keys=True),
        "dt": repr(trajectories.dt),
        "sha256": checksum(trajectories),
    }
    content = save({"states": trajectories.states, "lengths": trajectories.lengths}, metadata)
    write_atomically(path, content)


def read(path: Path) -> Trajectories:
    """Read trajectories and verify their checksum.

    Raises:
        ValueError: the checksum does not fit.
    """
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        states, lengths = file.get_tensor("states"), file.get_tensor("lengths")
    trajectories = Trajectories(states, lengths, float(metadata["dt"]))
    if checksum(trajectories) != metadata["sha256"]:
        message = "checksum mismatch"
        raise ValueError(message)
    return trajectories


def checksum(trajectories: Trajectories) -> str:
    """Return the SHA-256 of the states, the lengths and the sampling interval."""
    digest = hashlib.sha256(repr(trajectories.dt).encode())
    for tensor in (trajectories.lengths, trajectories.states):
        digest.update(tensor.contiguous().numpy().data)
    return digest.hexdigest()


def require_writable(folder: Path) -> None:
    """Create a folder and make sure that a file can be written into it.

    Raises:
        UserError: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        message = f"folder {folder}: expected a place that can be written; received: {error.strerror}"
        raise UserError(message) from error
