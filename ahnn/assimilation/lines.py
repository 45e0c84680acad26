"""Lines of a file or a pipe with their numbers, in constant memory, and those that were counted before."""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Iterator
from typing import BinaryIO

from ahnn.assimilation.journal import Journal
from ahnn.errors import UserError

LONGEST = 1 << 20
"""Bytes of a line; what is longer is no measurement, and not kept."""
CR = b"\r"


class Lines:
    """The lines of a stream.

    A file is read again from its beginning after a restart, and must be the same up to where it was read.
    What came through a pipe comes no second time: a journal keeps it.

    Args:
        stream: a file opened for bytes, a pipe whose state is not saved, or the journal of one.

    Attributes:
        number: of the last line, from 1.
        place: number of bytes up to its end.
    """

    def __init__(self, stream: BinaryIO | Journal) -> None:
        self.journal = stream if isinstance(stream, Journal) else None
        self.file = io.BufferedReader(stream) if isinstance(stream, Journal) else stream
        self.number = self.place = 0
        self._hash = hashlib.blake2b(digest_size=16)
        self._end = b""

    def __iter__(self) -> Iterator[str]:
        """Yield lines without their ends."""
        while raw := self._next():
            yield raw.decode("utf-8-sig", errors="replace").strip()

    def begin(self) -> None:
        """Begin with the first line."""
        if self.journal is not None:
            self.journal.begin()

    def resume(self, number: int, place: int, digest: str) -> None:
        """Go on behind a line.

        Raises:
            UserError: a file that has changed up to there.
        """
        if self.journal is not None:
            self.journal.resume(place)
            self.number, self.place = number, place
            return
        while self.number < number and self._next():
            pass
        if self.digest != digest:
            message = (
                f"measurements: expected the lines that were counted before, up to line {number}; received "
                "others. Add new ones at the end, or begin again with another state and output"
            )
            raise UserError(message)

    @property
    def digest(self) -> str:
        """Hash of all lines that were read."""
        return self._hash.hexdigest()

    def saved(self, place: int) -> None:
        """A state holds the stream up to a place."""
        if self.journal is not None:
            self.journal.saved(place)

    def close(self, *, discard: bool = False) -> None:
        """Close the stream; standard input stays open, and a journal, unless nothing began, in its place."""
        if discard and self.journal is not None:
            self.journal.path.unlink(missing_ok=True)
        if self.file is not sys.stdin.buffer:
            self.file.close()

    def _next(self) -> bytes:
        """Return the next line with its end; of one that is too long the beginning."""
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
        """Return bytes up to the end of a line, at most `LONGEST`."""
        if self._end == b"\n":
            return self.file.readline(LONGEST)
        found = b""
        while not found.endswith(CR) and (ahead := ahead_of(self.file)[: LONGEST - len(found)]):
            found += self.file.read(ahead.find(CR) + 1 or len(ahead))
        return found


def end_of_lines(file: BinaryIO) -> bytes:
    """Return what ends the lines of a stream: CR where only that stands among what it has at hand."""
    ahead = ahead_of(file)
    return CR if CR in ahead[:-1] and b"\n" not in ahead else b"\n"


def ahead_of(file: BinaryIO) -> bytes:
    """Return bytes that are read next, without reading on; none where that is not possible."""
    return file.peek() if isinstance(file, io.BufferedReader) else b""
