"""Lines of a file or a pipe with their numbers, in constant memory, and those that were counted before."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ahnn.errors import UserError

LONGEST = 1 << 20
"""Bytes of a line; what is longer is no measurement, and not kept."""


class Lines:
    """The lines of a stream.

    A file is read again from its beginning after a restart, and must be the same up to where it was read.
    What came through a pipe comes no second time: its lines are kept in a journal, until a state holds them.

    Args:
        file: opened for bytes.
        journal: path of the journal of a pipe; None for a file, and where no state is saved.
    """

    def __init__(self, file: BinaryIO, journal: Path | None = None) -> None:
        self.file, self.number = file, 0
        self._hash = hashlib.blake2b(digest_size=16)
        self._path, self._journal = journal, None if journal is None else journal.open("ab")

    def __iter__(self) -> Iterator[str]:
        """Yield lines without their ends; `number` counts them from 1."""
        for raw in iter(self._next, b""):
            self.number += 1
            self._hash.update(raw)
            if self._journal is not None:
                self._journal.write(b"%d\t%b" % (self.number, raw.rstrip(b"\n") + b"\n"))
                self._journal.flush()
            yield decoded(raw)

    def resumed(self, number: int, digest: str) -> Iterator[str]:
        """Go on behind a line, and yield those of the journal that came after it.

        Raises:
            UserError: a file that has changed up to there.
        """
        if self._path is None:
            for raw in iter(self._next, b"") if number else ():
                self._hash.update(raw)
                self.number += 1
                if self.number == number:
                    break
            if number and self.digest != digest:
                message = (
                    f"measurements: expected the lines that were counted before, up to line {number}; received "
                    "others. Add new ones at the end, or begin again with another state and output"
                )
                raise UserError(message)
            return
        self.number = number
        self._trim()
        for raw in self._path.read_bytes().splitlines(keepends=True):
            count, _, line = raw.partition(b"\t")
            if int(count) > number:
                self.number = int(count)
                yield decoded(line)

    @property
    def digest(self) -> str:
        """Hash of all lines of a file so far; of a pipe it is of no use."""
        return self._hash.hexdigest()

    def saved(self) -> None:
        """A state holds all lines so far."""
        if self._journal is not None:
            self._journal.truncate(0)

    def _trim(self) -> None:
        """Cut off half a line, which a kill may have left in the journal."""
        assert self._journal is not None
        assert self._path is not None
        self._journal.truncate(self._path.read_bytes().rfind(b"\n") + 1)

    def _next(self) -> bytes:
        """Return the next line with its end; of one that is too long the beginning."""
        raw = self.file.readline(LONGEST)
        part = raw
        while len(part) == LONGEST and not part.endswith(b"\n"):
            part = self.file.readline(LONGEST)
        return raw


def decoded(raw: bytes) -> str:
    """Return a line as text; what is no UTF-8 is marked, so that it is no number."""
    return raw.decode("utf-8-sig", errors="replace").strip()
