"""What a doctor of data finds: where it is, what it is, and what to do."""

from __future__ import annotations

from typing import Literal, NamedTuple

from ahnn.data.files.table import Fault, Remark

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
    def of(cls, said: Fault | Remark) -> Finding:
        """Return what a reader refuses or remarks on."""
        if isinstance(said, Remark):
            return cls(said.level, *said.place, said.what, said.remedy or "Nothing")
        what = f"expected {said.expected}; received {said.received}"
        return cls("fault", *said.place, what, said.remedy or "Correct it")
