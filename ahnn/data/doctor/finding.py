"""What a doctor of data finds: where it is, what it is, and what to do."""

from __future__ import annotations

from typing import Literal, NamedTuple

from ahnn.data.files.table import Fault

Level = Literal["fault", "warning", "note"]
"""A fault would spoil a training, a warning may, a note is good to know."""


class Finding(NamedTuple):
    """Something about a place of a file.

    Attributes:
        level: how bad it is.
        file: its name.
        row: number of the line or record; 0 where it is the file or the column as a whole.
        column: name of the column, "" where it is none.
        what: is the matter.
        remedy: what to do.
    """

    level: Level
    file: str
    row: int
    column: str
    what: str
    remedy: str

    @classmethod
    def of(cls, fault: Fault) -> Finding:
        """Return what a reader refuses."""
        what = f"expected {fault.expected}; received {fault.received}"
        return cls("fault", *fault.place, what, fault.remedy or "Correct it")
