"""Folders of later evaluations of a run, which never overwrite earlier ones."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from itertools import count
from pathlib import Path

from ahnn.errors import UserError
from ahnn.evaluation.results import FILE
from ahnn.evaluation.sinks.figure_files import pictures_in
from ahnn.files import claimed
from ahnn.manifest import own_folder, require_folder

NAME = re.compile(r"\w[\w.+=@-]{0,99}")
"""Portable folder names that are not hidden."""


@contextmanager
def evaluation_folder(run: Path, name: str | None = None) -> Iterator[Path]:
    """Create the folder of a new evaluation, `run/evaluations/NAME`, and lock it for this process.

    Args:
        run: run folder.
        name: name of the evaluation; None for date and time, such as `2026-05-04_13-59-07`.

    Raises:
        UserError: the name is invalid or taken, or the folder cannot be created.
        Occupied: another process evaluates under this name.
    """
    parent = run / "evaluations"
    if name is not None and not NAME.fullmatch(name):
        message = (
            "evaluation name: expected at most 100 letters, digits and . _ + = @ -, first a letter, a digit "
            f"or _, and no path; received {name!r}"
        )
        raise UserError(message)
    try:
        own_folder(parent)
        folder = _dated(parent) if name is None else _made(parent / name)
    except OSError as error:
        message = f"{parent}: expected a writable folder; received: {error.strerror}"
        raise UserError(message) from error
    with claimed(folder):
        require_unfinished(folder)  # another process may have finished it in the meantime
        yield folder


def require_unfinished(folder: Path) -> None:
    """Raise UserError for the folder of a finished evaluation, or a folder with files of other origin."""
    if folder.is_symlink() or (folder / FILE).exists():
        message = f"evaluation {folder.name}: expected a new name; received the name of {folder}"
        raise UserError(message)
    require_folder(folder, "evaluation", pictures_in(folder / "figures"), ("figures",))


def _made(folder: Path) -> Path:
    """Return a folder that is either new or left by an unfinished evaluation."""
    require_unfinished(folder)
    folder.mkdir(exist_ok=True)
    return folder


def _dated(parent: Path) -> Path:
    """Create a folder named by date and time, numbered if several start in one second."""
    now = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    for number in count(1):
        folder = parent / (now if number == 1 else f"{now}_{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError
