"""Atomic file writing: files appear complete or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from filelock import FileLock, Timeout

from ahnn.errors import Occupied, UserError
from ahnn.locks import lock
from ahnn.manifest import digest_of, record, recorded, require_own

UNFINISHED = re.compile(r"\.(.+)\.([0-9a-f]{32})\.tmp")
"""Name of a temporary file: target name and, where known, the first digits of the content's digest."""
MARK = 24
"""Number of digest digits in the name of a temporary file; random digits follow."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write bytes to a file atomically, and record it in the folder's manifest.

    Raises:
        UserError: the path is a link, or was not written by this program.
    """
    require_own([path], "file")
    path.parent.mkdir(parents=True, exist_ok=True)
    record(path, digest := digest_of(content))
    with atomic_file(path, digest[:MARK]) as file:
        file.write(content)


def write_cached(path: Path, content: bytes) -> None:
    """Write bytes atomically to a file in a cache folder, which contains nothing but cached files."""
    with atomic_file(path) as file:
        file.write(content)


def write_state(path: Path, content: bytes) -> None:
    """Write bytes atomically to a file that its content identifies as ours, in a folder of the user."""
    with atomic_file(path, digest_of(content)[:MARK]) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_file(path: Path, mark: str = "") -> Iterator[BinaryIO]:
    """Yield a temporary file next to `path`; on exit flush it to disk and rename it into place.

    Results are written by `write_atomically`, which first checks who wrote an existing file. The previous
    content of `path` survives any failure; a link is replaced and its target left unchanged. A writer locks
    its temporary file until its process ends, so that files left by killed writers are unlocked and the next
    writer removes them.

    Args:
        path: path of the file.
        mark: first digits of the content's digest, by which the manifest identifies a temporary file; ""
            for a cache folder, where all temporary files are ours.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_unfinished(path.parent, recorded(path.parent) if mark else None)
    temporary, file = _unfinished(path, mark)
    with file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
            if sys.platform == "win32":  # Windows cannot rename an open file
                file.close()
            temporary.replace(path)
        except BaseException as error:
            temporary.unlink(missing_ok=True)
            if isinstance(error, OSError):
                error.filename = str(path)  # the error for a full disk has no file name
            raise


def _unfinished(path: Path, mark: str) -> tuple[Path, BinaryIO]:
    """Return a new locked temporary file; retry if the file was removed before it was locked."""
    while True:
        temporary = path.with_name(f".{path.name}.{(mark + uuid4().hex)[:32]}.tmp")
        file = temporary.open("xb")
        with contextlib.suppress(OSError):  # without locks there is no clean-up
            lock(file)
        if temporary.exists():
            return temporary, file
        file.close()


def _remove_unfinished(folder: Path, known: dict[str, set[str]] | None) -> None:
    """Remove temporary files of terminated writers; in a results folder only files in the manifest."""
    for path in folder.glob(".*.tmp"):
        found = UNFINISHED.fullmatch(path.name)
        if not found or path.is_symlink() or not path.is_file():
            continue
        if known is not None and found[2][:MARK] not in {each[:MARK] for each in known.get(found[1], ())}:
            continue
        with contextlib.suppress(OSError), path.open("r+b") as file:  # it is gone, or its writer is alive
            lock(file, wait=False)
            path.unlink()  # not possible on Windows, where the file stays


@contextlib.contextmanager
def claimed(folder: Path, name: str = ".claim") -> Iterator[None]:
    """Lock a folder for this process; the lock ends with the process, however it terminates.

    Args:
        folder: folder to lock.
        name: name of the lock file; locks of different names do not exclude each other.

    Raises:
        Occupied: another process has locked the folder.
        UserError: a user's file has the name of the lock file.
    """
    place = folder / name
    if place.is_symlink() or (place.exists() and (not place.is_file() or place.stat().st_size)):
        message = (
            f"{place}: expected no file of that name, or an empty one; received one with content. Move it"
        )
        raise UserError(message)
    try:
        with FileLock(place, timeout=0):
            try:
                yield
            finally:
                with contextlib.suppress(PermissionError):  # Windows removes the file with its lock
                    place.unlink(missing_ok=True)
    except Timeout as error:
        message = f"folder {folder}: expected one that no other process uses; received one in use"
        raise Occupied(message) from error


def require_writable(folder: Path) -> None:
    """Create a folder and check that it is writable.

    Raises:
        UserError: the folder cannot be created or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        message = f"folder {folder}: expected a writable place; received: {error.strerror}"
        raise UserError(message) from error


@contextlib.contextmanager
def writable_folder(folder: Path) -> Iterator[None]:
    """Create a folder, check that it is writable, and remove it if the body fails and has left it empty.

    Raises:
        UserError: the folder cannot be created or written to.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        require_writable(folder)
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            for path in made:
                path.rmdir()
        raise


@contextlib.contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary folder that is renamed to the target on success and removed otherwise."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    place = folder.with_name(f".{folder.name}.{uuid4().hex}.tmp")
    place.mkdir()
    try:
        yield place
        place.rename(folder)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
