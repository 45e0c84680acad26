"""Numbered lines of a file or pipe in constant memory, with resumption after processed lines."""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Iterator
from typing import BinaryIO

from ahnn.assimilation.journal import Journal
from ahnn.errors import UserError

LONGEST = 1 << 20
"""Maximum number of bytes of a line; longer lines are invalid and truncated."""
CR = b"\r"


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
        self._end = b""

    def __iter__(self) -> Iterator[str]:
        """Yield lines without line terminators."""
        while raw := self._next():
            yield raw.decode("utf-8-sig", errors="replace").strip()

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
        while self.number < number and self._next():
            pass
        if self.digest != digest:
            message = (
                f"measurements: expected the lines processed before, up to line {number}, unchanged; "
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
        """Close the stream, except standard input; a journal stays on disk if processing has begun."""
        if discard and self.journal is not None:
            self.journal.path.unlink(missing_ok=True)
        if self.file is not sys.stdin.buffer:
            self.file.close()

    def _next(self) -> bytes:
        """Return the next line with its terminator, truncated if too long."""
        self._end = self._end or end_of_lines(self.file)
        raw = part = self._part()
        while part:
            self.place += len(part)
            self._hash.update(part)
            if len(part) < LONGEST or part.endswith(self._end):
                self.number += 1
                break
            part = self._part()
        return raw

    def _part(self) -> bytes:
        """Read bytes up to the end of a line, at most `LONGEST`."""
        if self._end == b"\n":
            return self.file.readline(LONGEST)
        found = b""
        while not found.endswith(CR) and (ahead := ahead_of(self.file)[: LONGEST - len(found)]):
            found += self.file.read(ahead.find(CR) + 1 or len(ahead))
        return found


def end_of_lines(file: BinaryIO) -> bytes:
    """Return the line terminator of a stream: CR if buffered bytes contain only CR."""
    ahead = ahead_of(file)
    return CR if CR in ahead[:-1] and b"\n" not in ahead else b"\n"


def ahead_of(file: BinaryIO) -> bytes:
    """Peek at the next bytes without consuming them; empty if not possible."""
    return file.peek() if isinstance(file, io.BufferedReader) else b""
