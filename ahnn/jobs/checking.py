"""What is wrong with files of data, shown and drawn before anything is learned from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ahnn.data.doctor import examine
from ahnn.data.files.reading import FileReading
from ahnn.errors import UserError
from ahnn.evaluation.data_findings import checkup, draw
from ahnn.evaluation.terminal import show
from ahnn.files import require_writable


def check(paths: Sequence[Path], figures: Path | None, options: dict[str, Any]) -> None:
    """Show all that is wrong with files.

    Args:
        paths: of the files.
        figures: folder for drawings, or None.
        options: mass, gap, and those of `Reading`.

    Raises:
        UserError: something that would spoil a training.
    """
    if figures is not None:
        require_writable(figures)
    mass, gap = options.get("mass"), options.get("gap", 10.0)
    how = {key: value for key, value in options.items() if key not in ("mass", "gap")}
    found = examine(paths, FileReading(mass is not None, **how), mass, gap)
    show(checkup(found))
    if figures is not None:
        draw(found, figures)
    if count := len(found.faults):
        what = "1 fault that would" if count == 1 else f"{count} faults that would"
        message = f"check: expected sound data; received {what} spoil a training"
        raise UserError(message)
