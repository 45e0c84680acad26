"""Generated trajectories on disk: one file per content hash, written atomically, verified on load.

Files are in the safetensors format, which contains no executable content. They are written part by part and
memory-mapped, and so may exceed the memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import logging
import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from filelock import FileLock
from safetensors import SafetensorError, safe_open
from torch import Tensor

from ahnn.contents import require_regular
from ahnn.files import atomic_file, require_writable
from ahnn.systems import System
from ahnn.types import Trajectories

log = logging.getLogger(__name__)

FORMAT = 4
"""Format version, increased when the meaning of a file changes, for example after a fix of the generator."""
BLOCK = 2**24
"""Number of bytes read at once for a checksum."""
SPARE = 512
"""Maximum header size in bytes, excluding metadata."""


def recipe(system: System, count: int, seed: int) -> dict[str, Any]:
    """Return the complete definition of a data set, as plain values."""
    kind = type(system)
    known = {
        "system": f"{kind.__module__}.{kind.__qualname__}",
        "parameters": system.parameters(),
        "integrator": system.integrator,
        "count": count,
        "seed": seed,
    }
    known |= {"singular": True} if system.singular else {}
    return known | ({"code": code} if (code := source_of(kind)) else {})


def source_of(kind: type) -> dict[str, str]:
    """Return the hashes of the modules that define a system and its bases; `FORMAT` covers modules of ahnn.

    Hashes complete modules, since a force may call other functions of its module.
    """
    modules = {base.__module__ for base in kind.__mro__} - {"builtins", "abc"}
    return {
        name: hashlib.sha256(_source(name, kind).encode()).hexdigest()[:16]
        for name in sorted(modules)
        if name.partition(".")[0] != "ahnn"
    }


def _source(name: str, kind: type) -> str:
    """Return the source of a module; if missing, the source of the class, or else its bytecode."""
    for place in (sys.modules.get(name), kind):
        with contextlib.suppress(OSError, TypeError):
            return inspect.getsource(place)  # pyright: ignore[reportArgumentType]
    return repr({key: _bytecode(value) for key, value in vars(kind).items()})


def _bytecode(value: Any) -> Any:
    """Return the bytecode, constants and names of a function; for other objects, only plain values."""
    function = getattr(value, "fget", getattr(value, "__func__", value))
    if isinstance(function, FunctionType):
        return _bytecode(function.__code__), function.__defaults__, function.__kwdefaults__
    if isinstance(value, CodeType):
        return value.co_code, value.co_names, [_bytecode(part) for part in value.co_consts]
    if isinstance(value, frozenset):  # sets in code are unordered
        return sorted(map(repr, value))
    return value if isinstance(value, bool | int | float | str | bytes | tuple) else type(value).__name__


def load_or_make(
    folder: Path, wanted: dict[str, object], make: Callable[[], Iterable[Trajectories]]
) -> Trajectories:
    """Load the trajectories of a recipe; generate and store them if they are missing or damaged.

    If several processes need the same missing data, one generates them and the others wait.

    Args:
        folder: folder of the stored files.
        wanted: recipe of the data.
        make: function that returns the parts for `write`.

    Raises:
        UserError: the folder is not writable.
    """
    path = place(folder, wanted)
    stored = stored_in(path)
    if stored is not None:
        return stored
    require_writable(folder)
    with FileLock(folder / ".lock"):
        stored = stored_in(path)
        if stored is None:
            write(path, make(), wanted)
            stored = read(path)
    return stored


def place(folder: Path, wanted: dict[str, object]) -> Path:
    """Return the path of a recipe's file."""
    key = hashlib.sha256(json.dumps({"format": FORMAT, **wanted}, sort_keys=True).encode()).hexdigest()[:16]
    return folder / f"{key}.safetensors"


def stored_in(path: Path) -> Trajectories | None:
    """Return the trajectories in a file; None if it is missing or damaged."""
    if not path.exists():
        return None
    try:
        return read(path)
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        log.warning("data: %s is damaged (%s); it will be generated again", path, error)
        return None


def write(path: Path, parts: Iterable[Trajectories], made_from: dict[str, object]) -> None:
    """Write trajectories with their recipe and a checksum, atomically.

    Args:
        path: path of the file.
        parts: parts of the trajectories in order; all parts share the times of the first.
        made_from: recipe of the data.
    """
    written, digest, times, shape = 0, hashlib.sha256(), None, (0, 0, 0)
    with atomic_file(path) as file:
        for part in parts:
            if times is None:
                times, shape = shared_times(part), part.states.shape
                digest.update(content(times))
                file.write(header(made_from, digest.hexdigest(), shape, times.shape))  # placeholder
            digest.update(content(part.states))
            file.write(content(part.states))
            written += len(part.states)
        assert times is not None
        file.write(content(times))
        file.seek(0)
        shapes = (written, *shape[1:]), times.shape
        file.write(header(made_from, sealed(digest, *shapes), *shapes))


def header(made_from: dict[str, object], sha256: str, states: Sequence[int], times: Sequence[int]) -> bytes:
    """Return the safetensors header of states and times, padded to a length independent of the shapes."""
    metadata = {"recipe": json.dumps(made_from, sort_keys=True), "sha256": sha256}
    end, last = 8 * math.prod(states), 8 * (math.prod(states) + math.prod(times))
    entries = {
        "__metadata__": metadata,
        "states": {"dtype": "F64", "shape": [*states], "data_offsets": [0, end]},
        "times": {"dtype": "F64", "shape": [*times], "data_offsets": [end, last]},
    }
    text = json.dumps(entries, separators=(",", ":")).encode()
    plain = len(json.dumps(metadata))
    return (size := plain + SPARE - plain % 8).to_bytes(8, "little") + text.ljust(size)


def read(path: Path) -> Trajectories:
    """Memory-map trajectories after verifying their checksum; changes are not written to the file.

    Raises:
        ValueError: the checksum does not match.
    """
    require_regular(path)
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        states, times = file.get_tensor("states"), file.get_tensor("times")
    if checksum_in(path, states.shape, times) != metadata["sha256"]:
        message = "checksum mismatch"
        raise ValueError(message)
    return Trajectories(states, times).each_timed()


def checksum_in(path: Path, states: Sequence[int], times: Tensor) -> str:
    """Compute the checksum of a file with states, of the declared shape, followed by times.

    Reads the file instead of its memory map, which would load all of it into memory.
    """
    digest = hashlib.sha256(content(times))
    with path.open("rb") as file:
        begin = 8 + int.from_bytes(file.read(8), "little")
        left = os.fstat(file.fileno()).st_size - begin - times.nbytes
        file.seek(begin)
        while left > 0 and (block := file.read(min(left, BLOCK))):
            digest.update(block)
            left -= len(block)
    return sealed(digest, states, times.shape)


def checksum(trajectories: Trajectories) -> str:
    """Return the SHA-256 of the times, the states and their shapes."""
    times = shared_times(trajectories)
    digest = hashlib.sha256(content(times))
    digest.update(content(trajectories.states))
    return sealed(digest, trajectories.states.shape, times.shape)


def sealed(digest: Any, states: Sequence[int], times: Sequence[int]) -> str:
    """Return the digest of contents and their shapes."""
    digest.update(f"{[*states]}{[*times]}".encode())
    return digest.hexdigest()


def content(tensor: Tensor) -> memoryview:
    """Return the bytes of a tensor."""
    return tensor.contiguous().numpy().data.cast("B")


def shared_times(trajectories: Trajectories) -> Tensor:
    """Return the times (B, T), or a single row (1, T) if common to all trajectories."""
    times = trajectories.times
    shared = times.stride(0) == 0 or bool((times == times[:1]).all())
    return times[:1].contiguous() if shared else times.contiguous()
