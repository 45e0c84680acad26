"""Numbered lines of a file or pipe in constant memory, with resumption after processed lines."""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO, cast

from ahnn.assimilation.journal import Journal
from ahnn.errors import UserError

LONGEST = 1 << 20
"""Maximum number of bytes of a line; longer lines are invalid and truncated."""
CR, LF = b"\r", b"\n"
SIZE = 1 << 16
"""Maximum number of bytes that are read at once."""


class Lines:
    """Lines of a stream.

    After a restart a file is read from its beginning, and must be unchanged up to the position reached. A
    pipe cannot be read twice, so its input is kept in a journal.

    Args:
        stream: a binary file, a pipe whose state is not saved, or the journal of a pipe.

    Attributes:
        number: number of the last line, from 1.
        place: byte offset of its end.
    """

    def __init__(self, stream: BinaryIO | Journal) -> None:
        self.journal = stream if isinstance(stream, Journal) else None
        self.file = io.BufferedReader(stream) if isinstance(stream, Journal) else stream
        self.number = self.place = 0
        self._hash = hashlib.blake2b(digest_size=16)
        self._end, self._ahead = b"", b""

    def __iter__(self) -> Iterator[str]:
        """Yield lines without line terminators."""
        while texts := self.arrived(1):
            yield texts[0]

    def arrived(self, most: int) -> list[str]:
        """Wait for a line; return it and later lines that have arrived, at most `most`; [] at the end.

        Lines have no terminators.
        """
        while (not self._end or self._end not in self._ahead) and len(self._ahead) < LONGEST and self._read():
            pass
        if not self._ahead:
            return []
        if self._end not in self._ahead:
            return [self._last()]
        *lines, self._ahead = self._ahead.split(self._end, most)
        whole = self._end.join((*lines, b""))
        self._passed(whole, len(lines))
        return [_text(line) for line in lines]

    def table(self, count: int) -> list[str]:
        """Return the next `count` lines, or fewer at the end of the stream."""
        texts = list[str]()
        while len(texts) < count and (more := self.arrived(count - len(texts))):
            texts += more
        return texts

    def begin(self) -> None:
        """Start at the first line."""
        if self.journal is not None:
            self.journal.begin()

    def resume(self, number: int, place: int, digest: str) -> None:
        """Resume after a line.

        Raises:
            UserError: the file has changed before that line.
        """
        if self.journal is not None:
            self.journal.resume(place)
            self.number, self.place = number, place
            return
        while self.number < number and self.arrived(number - self.number):
            pass
        if self.digest != digest:
            message = (
                f"measurements: expected the lines already processed, up to line {number}, unchanged; "
                "received different lines. Append new lines, or start over with a new state and output"
            )
            raise UserError(message)

    @property
    def digest(self) -> str:
        """Hash of all lines read."""
        return self._hash.hexdigest()

    def saved(self, place: int) -> None:
        """Record that a saved state includes the stream up to an offset."""
        if self.journal is not None:
            self.journal.saved(place)

    def close(self, *, discard: bool = False) -> None:
        """Close the stream, except standard input; `discard` also removes a journal from disk."""
        if discard and self.journal is not None:
            self.journal.path.unlink(missing_ok=True)
        if self.file is not sys.stdin.buffer:
            self.file.close()

    def _read(self) -> bool:
        """Read the available bytes, or wait for some; return False at the end of the stream."""
        more: bytes = cast(Any, self.file).read1(SIZE)
        self._end = self._end or (CR if CR in more[:-1] and LF not in more else LF if more else b"")
        self._ahead += more
        return bool(more)

    def _last(self) -> str:
        """Return the last line of the stream, or the beginning of a line that is too long."""
        text = _text(self._ahead)
        while self._end not in self._ahead:
            self._passed(self._ahead, 0)
            self._ahead = b""
            if not self._read():
                break
        line, end, self._ahead = self._ahead.partition(self._end)
        self._passed(line + end, 1)
        return text

    def _passed(self, content: bytes, lines: int) -> None:
        """Count bytes and lines."""
        self.place += len(content)
        self.number += lines
        self._hash.update(content)


def _text(line: bytes) -> str:
    """Return the text of a line, truncated if too long."""
    return line[:LONGEST].decode("utf-8-sig", errors="replace").strip()
