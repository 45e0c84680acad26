"""Command line of the data check: `check PATH... [key=value]`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ahnn.arguments import check_values, nearest
from ahnn.cli.commandline import pair
from ahnn.cli.pairs import divided
from ahnn.data.files import Files
from ahnn.errors import UserError, WrongUsage

KEYS = ("mass", "gap", "frame", "step", "duration")
"""Options of `system=files`."""


def read_check(arguments: list[str]) -> tuple[list[Path], Path | None, dict[str, Any]]:
    """Parse the files, the folder for figures and the options of a command line; raises UserError."""
    paths, pairs = divided(arguments[1:], (*KEYS, "figures"))
    named = [text.partition("=")[0] for text in pairs]
    if unknown := [key for key in named if key not in (*KEYS, "figures")]:
        message = f"check: unknown key {unknown[0]!r}{nearest(unknown[0], (*KEYS, 'figures'))}"
        raise UserError(message)
    if arguments[:1] != ["check"] or not paths:
        message = f"received: {' '.join(arguments) or 'nothing'}"
        raise WrongUsage(message)
    options = dict(map(pair, pairs))
    figures = options.pop("figures", None)
    check_values("", Files, options)
    return paths, None if figures is None else Path(str(figures)), options
