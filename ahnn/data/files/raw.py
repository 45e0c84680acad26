"""Raw bytes and text of a file, with uniform error messages."""

from __future__ import annotations

from pathlib import Path

from ahnn.contents import read_whole
from ahnn.data.files.table import Place
from ahnn.errors import UserError
from ahnn.memory import available


def content_of(path: Path, key: str = "") -> bytes:
    """Return the bytes of a file; raises UserError, which names the key of its path, if it cannot be read."""
    try:
        return read_whole(path, available())
    except OSError as error:
        message = f"{key or 'file'}: expected a file; received {path}: {error.strerror}"
        raise UserError(message) from error


def decoded(raw: bytes, path: Path) -> str:
    """Return the text of a file, with line feeds as line ends; raises UserError if it is not text."""
    try:
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        row = len(raw[: error.start + 1].splitlines())
        Place(str(path), row).refuse("UTF-8 text", repr(raw[error.start : error.start + 1]))
