"""Record of final losses for a plain grid multirun: a file of JSON lines in the sweep folder.

Jobs append under a lock, since several may end at the same time. An incomplete line of a killed job is
skipped and never joined with the next one.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import IO, Any

from ahnn.locks import lock


class Record:
    """Final losses of the complete runs of one group.

    Args:
        path: path of the file; its folder must exist.
        group: runs of different groups (for example systems) are never compared.
    """

    def __init__(self, path: Path, group: str) -> None:
        self.path = path
        self.group = group

    def finals(self) -> list[float]:
        """Return the final losses recorded so far in this group."""
        if not self.path.exists():
            return []
        with self.path.open("rb") as file:
            lock(file)
            lines = file.read().splitlines()
        rows = [row for row in map(_parsed, lines) if row is not None]
        return [float(row["loss"]) for row in rows if row["group"] == self.group]

    def append(self, run: str, loss: float) -> None:
        """Add the final loss of a complete run; non-finite losses are skipped."""
        if not math.isfinite(loss):
            return
        line = json.dumps({"group": self.group, "run": run, "loss": loss}).encode() + b"\n"
        with self.path.open("ab+") as file:
            lock(file)
            file.write(line if _ends_a_line(file) else b"\n" + line)


def _ends_a_line(file: IO[bytes]) -> bool:
    """Return whether the file is empty or its last byte is a line feed."""
    if file.seek(0, os.SEEK_END) == 0:
        return True
    file.seek(-1, os.SEEK_END)
    return file.read(1) == b"\n"


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the row of a line, or None for an incomplete line of a killed job."""
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None
