"""Where a later evaluation of a run is kept: beside the earlier ones, never over them."""

from __future__ import annotations

import re
from datetime import datetime
from itertools import count
from pathlib import Path

from ahnn.errors import UserError
from ahnn.evaluation.results import FILE

NAME = re.compile(r"\w[\w.+=@-]{0,99}")
"""Names that are one folder on any system, and no hidden one."""


def evaluation_folder(run: Path, name: str | None = None) -> Path:
    """Make and return the folder of a new evaluation, `run/evaluations/NAME`.

    Args:
        run: the run folder.
        name: of the evaluation; None takes date and time, such as `2026-05-04_13-59-07`.

    Raises:
        UserError: the name is no plain one, or taken; or the folder cannot be made.
    """
    parent = run / "evaluations"
    if name is not None and not NAME.fullmatch(name):
        message = (
            "evaluation name: expected at most 100 letters, digits and . _ + = @ -, first a letter, a digit "
            f"or _, and no path; received {name!r}"
        )
        raise UserError(message)
    try:
        parent.mkdir(parents=True, exist_ok=True)
        return _dated(parent) if name is None else _named(parent / name)
    except OSError as error:
        message = f"{parent}: expected a place for a new folder; received: {error.strerror}"
        raise UserError(message) from error


def _named(folder: Path) -> Path:
    """Return the folder of this name, new or left without results by an evaluation that did not finish."""
    if folder.is_symlink() or (folder / FILE).exists():
        message = f"evaluation {folder.name}: expected a new name; received that of {folder}"
        raise UserError(message)
    folder.mkdir(exist_ok=True)
    return folder


def _dated(parent: Path) -> Path:
    """Return a new folder named by date and time, numbered where several begin in one second."""
    now = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    for number in count(1):
        folder = parent / (now if number == 1 else f"{now}_{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError
