"""Merging of workers' outputs: rows in the order of the input lines, as a single worker would write them."""

from __future__ import annotations

import hashlib
import heapq
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from ahnn.assimilation.output_rows import Rows
from ahnn.errors import UserError
from ahnn.files import MARK, atomic_file
from ahnn.manifest import record


class MergedRows:
    """Rows of several outputs, each for different objects, as CSV or JSON lines.

    Args:
        rows: formatter of the rows.
        paths: outputs of the workers; a missing file counts as empty.
    """

    def __init__(self, rows: Rows, paths: Sequence[Path]) -> None:
        self.head, self.is_json = rows.header().encode(), rows.kind == "json"
        self.paths = [path for path in paths if path.exists()]

    def __iter__(self) -> Iterator[bytes]:
        """Yield the rows in the order of their lines."""
        with ExitStack() as stack:
            files = [stack.enter_context(path.open("rb")) for path in self.paths]
            for file in files:
                file.seek(len(self.head))
            yield from heapq.merge(*files, key=self._line)

    def write(self, path: Path, expected: int) -> None:
        """Write all rows to a file, atomically.

        Args:
            path: path of the file.
            expected: number of rows.

        Raises:
            UserError: the number of rows differs, or a file with the manifest's name is not a manifest.
        """
        known, count = hashlib.sha256(self.head), 0
        for row in self:
            known.update(row)
            count += 1
        if count != expected:
            message = (
                f"state: expected {expected} rows in the outputs of all workers; received {count}. "
                "Start over with a new state and output"
            )
            raise UserError(message)
        record(path, known.hexdigest())
        with atomic_file(path, known.hexdigest()[:MARK]) as file:
            file.write(self.head)
            file.writelines(self)

    def objects(self) -> dict[str, int]:
        """Return the objects in the order of their first rows, with their positions in this order."""
        order: dict[str, int] = {}
        for row in self:
            name = json.loads(row)["object"] if self.is_json else row.split(b",", 2)[1].decode()
            order.setdefault(name, len(order))
        return order

    def _line(self, row: bytes) -> int:
        """Return the input line number of a row."""
        return int(row[len(b'{"line": ') : row.index(b",")] if self.is_json else row[: row.index(b",")])
