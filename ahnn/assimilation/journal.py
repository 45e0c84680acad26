"""Write-ahead journal of a pipe: input is kept on disk until a saved state includes it."""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ahnn.contents import read_whole
from ahnn.errors import UserError
from ahnn.files import write_state
from ahnn.memory import available


class Journal(io.RawIOBase):
    """Input stream of a pipe, which cannot be read twice, written to a file before use.

    Each piece is preceded by a line with its length and checksum; the first piece is the stream offset of the
    rest.

    Args:
        pipe: pipe to read.
        path: path of the journal file.
    """

    def __init__(self, pipe: BinaryIO, path: Path) -> None:
        super().__init__()
        self.pipe, self.path = pipe, path
        self._base, self._kept, self._ahead = 0, bytearray(), b""
        self._file: BinaryIO | None = None

    def begin(self) -> None:
        """Start an empty journal.

        Raises:
            UserError: a journal exists without its state.
        """
        if os.path.lexists(self.path):
            message = (
                f"state: expected the state that belongs to the journal {self.path}; received none. Remove "
                "the journal"
            )
            raise UserError(message)
        self.saved(0)

    def resume(self, place: int) -> None:
        """Resume at an offset of the stream, first with the content of the journal after it.

        Raises:
            UserError: the journal is missing or damaged.
        """
        try:
            head, *pieces = _pieces(read_whole(self.path, available()))
            self._base, content = int(head), b"".join(pieces)
            if not 0 <= place - self._base <= len(content):
                message = f"one with bytes {self._base} to {self._base + len(content)}, without byte {place}"
                raise ValueError(message)  # noqa: TRY301 - one message for every kind of damage
        except (OSError, ValueError) as error:
            message = (
                f"state: expected an intact journal {self.path}; received {error}. Start over with a new "
                "state and output"
            )
            raise UserError(message) from error
        self._kept = bytearray(content)
        self._ahead = bytes(content[place - self._base :])
        self._file = self.path.open("ab")

    def readable(self) -> bool:
        """Return True: the stream is readable."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Read pending bytes of the journal, or available bytes of the pipe."""
        if self._ahead:
            content, self._ahead = self._ahead[: len(buffer)], self._ahead[len(buffer) :]
        else:
            content = self.pipe.read(len(buffer)) or b""
            self._kept += content
            assert self._file is not None
            self._file.write(_piece(content))
            self._file.flush()
        buffer[: len(content)] = content
        return len(content)

    def saved(self, place: int) -> None:
        """Discard bytes before the offset included in a saved state; keep those read beyond it."""
        del self._kept[: place - self._base]
        self._base = place
        write_state(self.path, _piece(b"%d" % place) + _piece(self._kept))
        self._close()
        self._file = self.path.open("ab")

    def close(self) -> None:
        """Close the journal file; the pipe stays open."""
        self._close()
        super().close()

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()


def _piece(content: bytes | bytearray) -> bytes:
    """Return bytes preceded by their length and checksum."""
    return b"%d %d\n%b" % (len(content), zlib.crc32(content), content)


def _pieces(journal: bytes) -> Iterator[bytes]:
    """Yield the pieces written by `_piece`; raises ValueError for other content."""
    while journal:
        head, _, journal = journal.partition(b"\n")
        size, checksum = map(int, head.split(b" "))
        piece, journal = journal[:size], journal[size:]
        if size != len(piece) or size < 0 or checksum != zlib.crc32(piece):
            message = "a damaged one"
            raise ValueError(message)
        yield piece
