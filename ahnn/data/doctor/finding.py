"""Findings of the data doctor: location, description and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from ahnn.data.files.table import Fault, Remark

Level = Literal["fault", "warning", "note"]
"""Severity levels: a fault would spoil the training, a warning may, a note is informative."""


def is_consequence(fault: Fault, before: Iterable[Fault | Remark]) -> bool:
    """Return whether a fault only says that the rows with earlier faults leave nothing in the file."""
    faults = (one for one in before if isinstance(one, Fault))
    return fault.received == "none" and any(one.place.file == fault.place.file for one in faults)


class Finding(NamedTuple):
    """Finding at a place in a file.

    Attributes:
        level: severity.
        file: file name.
        row: line or record number; 0 for the entire file or column.
        column: column name, or "".
        what: description of the defect.
        remedy: what the user can do.
        size: size of the defect; of similar findings the largest are listed first.
    """

    level: Level
    file: str
    row: int
    column: str
    what: str
    remedy: str
    size: float = 0.0

    @classmethod
    def of(cls, said: Fault | Remark) -> Finding:
        """Convert a reader's fault or remark to a finding."""
        if isinstance(said, Remark):
            return cls(said.level, *said.place, said.what, said.remedy or "Nothing")
        what = f"expected {said.expected}; received {said.received}"
        return cls("fault", *said.place, what, said.remedy or "Correct it")
