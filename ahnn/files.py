"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from filelock import FileLock, Timeout

from ahnn.errors import Occupied, UserError
from ahnn.manifest import digest_of, record, recorded, require_own

UNFINISHED = re.compile(r"\.(.+)\.([0-9a-f]{32})\.tmp")
"""Name of a temporary file: of its target, and of the first digits of its content where that is known."""
MARK = 24
"""Digits of a content in the name of a temporary file; random ones follow."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write bytes to a file that appears whole or not at all, and record it in the folder's manifest.

    Raises:
        UserError: something is there that this program did not write, or a link.
    """
    require_own([path], "file")
    path.parent.mkdir(parents=True, exist_ok=True)
    record(path, digest := digest_of(content))
    with atomic_file(path, digest[:MARK]) as file:
        file.write(content)


def write_cached(path: Path, content: bytes) -> None:
    """Write bytes to a file of a cache, whose folder holds nothing else."""
    with atomic_file(path) as file:
        file.write(content)


def write_state(path: Path, content: bytes) -> None:
    """Write bytes to a file that proves by its content that it is ours, in somebody's folder."""
    with atomic_file(path, digest_of(content)[:MARK]) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, mark: str = "") -> Iterator[BinaryIO]:
    """Give a temporary file beside `path`; afterwards flush it to the disk and rename it into place.

    Results are written by `write_atomically`, which looks first whose file is there. What was at `path`
    survives any failure; a link there is replaced and its target left alone. Whoever writes holds a lock on
    its temporary file, which ends with the process: what killed writers left in the folder is not locked, and
    the next one removes it.

    Args:
        path: of the file.
        mark: first digits of the content's digest, by which the manifest knows a temporary file; without
            them the folder is a cache, where all temporary files are ours.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_unfinished(path.parent, recorded(path.parent) if mark else None)
    temporary, file = _unfinished(path, mark)
    with file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException as error:
            temporary.unlink(missing_ok=True)
            if isinstance(error, OSError):
                error.filename = str(path)  # a full disk names no file
            raise


def _unfinished(path: Path, mark: str) -> tuple[Path, BinaryIO]:
    """Return a new temporary file with a lock on it; another one where a remover came before the lock."""
    while True:
        temporary = path.with_name(f".{path.name}.{(mark + uuid4().hex)[:32]}.tmp")
        file = open(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666), "wb")  # noqa: SIM115
        with contextlib.suppress(OSError):  # a file system without locks: nobody removes anything there
            fcntl.flock(file, fcntl.LOCK_EX)
        if temporary.exists():
            return temporary, file
        file.close()


def _remove_unfinished(folder: Path, known: dict[str, set[str]] | None) -> None:
    """Remove the temporary files of writers that are gone; in a folder of results those on record alone."""
    for path in folder.glob(".*.tmp"):
        found = UNFINISHED.fullmatch(path.name)
        if not found or path.is_symlink() or not path.is_file():
            continue
        if known is not None and found[2][:MARK] not in {each[:MARK] for each in known.get(found[1], ())}:
            continue
        with contextlib.suppress(OSError), path.open("r+b") as file:  # it is gone, or its writer lives
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


@contextlib.contextmanager
def claimed(folder: Path, name: str = ".claim") -> Iterator[None]:
    """Hold a folder for this process alone; the claim ends with the process, however that ends.

    Args:
        folder: to hold.
        name: of the file that is locked; claims of different names do not exclude each other.

    Raises:
        Occupied: another process holds it.
        UserError: somebody's file has the name of the claim.
    """
    place = folder / name
    if place.is_symlink() or (place.exists() and (not place.is_file() or place.stat().st_size)):
        message = f"{place}: expected no file of that name, or an empty one; received another. Move it"
        raise UserError(message)
    lock = FileLock(place, timeout=0)
    try:
        with lock:
            try:
                yield
            finally:
                place.unlink(missing_ok=True)
    except Timeout as error:
        message = f"folder {folder}: expected one of its own; received one that another process writes into"
        raise Occupied(message) from error


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


@contextlib.contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Give an empty folder that takes the name of a new one when all is written, and vanishes otherwise."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    place = folder.with_name(f".{folder.name}.{uuid4().hex}.tmp")
    place.mkdir()
    try:
        yield place
        place.rename(folder)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
