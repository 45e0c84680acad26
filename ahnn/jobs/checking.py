"""Data check: defects of data files shown and plotted before training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ahnn.data.doctor import examine
from ahnn.data.files.kinds import TRACKING, kind_of
from ahnn.data.files.raw import content_of
from ahnn.data.files.reading import FileReading
from ahnn.errors import UserError
from ahnn.evaluation.data_figures import draw
from ahnn.evaluation.data_findings import checkup
from ahnn.evaluation.terminal import show
from ahnn.files import require_writable
from ahnn.jobs.tracking_checking import tracking_check

PROPAGATED: dict[str, Any] = {"step": 60.0, "duration": 86400.0}
"""Default sampling of the orbits of element sets, in seconds."""


def check(paths: Sequence[Path], figures: Path | None, options: dict[str, Any]) -> None:
    """Show all defects of files: trajectories jointly, tracking files individually.

    Args:
        paths: paths of the files.
        figures: folder for figures of trajectories and measurements, or None.
        options: mass, gap, and reading options.

    Raises:
        UserError: a defect that would spoil the training, or tracking data that cannot be read.
    """
    tracking = [path for path in paths if is_tracking(path)]
    if figures is not None and len(tracking) < len(paths):
        require_writable(figures)
    faults = 0
    for path in tracking:
        findings, shown = tracking_check(path, figures)
        show(shown)
        faults += sum(one.level == "fault" for one in findings)
    if others := [path for path in paths if path not in tracking]:
        mass, gap = options.get("mass"), options.get("gap", 10.0)
        how = PROPAGATED | {key: value for key, value in options.items() if key not in ("mass", "gap")}
        found = examine(others, FileReading(**how), mass, gap)
        show(checkup(found))
        if figures is not None:
            draw(found, figures)
        faults += len(found.faults)
    if faults:
        what = "1 fault that would" if faults == 1 else f"{faults} faults that would"
        purpose = "spoil an orbit determination" if not others else "spoil the training"
        message = f"check: expected valid data; received {what} {purpose}"
        raise UserError(message)


def is_tracking(path: Path) -> bool:
    """Return whether a file contains tracking data or related tables instead of trajectories."""
    try:
        return kind_of(content_of(path), str(path)) in TRACKING
    except UserError:
        return False
