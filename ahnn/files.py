"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

from filelock import FileLock, Timeout

from ahnn.errors import UserError


def write_atomically(path: Path, content: bytes) -> None:
    """Write bytes to a temporary file beside `path`, flush it to the disk, and rename it into place.

    What was at `path` survives any failure; a link there is replaced and its target left alone.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{uuid4().hex}.tmp")
    try:
        with open(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Hold a folder for this process alone; the claim ends with the process, however that ends.

    Raises:
        UserError: another process holds it.
    """
    lock = FileLock(folder / ".claim", timeout=0)
    try:
        with lock:
            try:
                yield
            finally:
                (folder / ".claim").unlink(missing_ok=True)
    except Timeout as error:
        message = f"folder {folder}: expected one of its own; received one that another process writes into"
        raise UserError(message) from error


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
