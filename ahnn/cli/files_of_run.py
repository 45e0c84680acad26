"""Data files of a finished run whose relative paths start from the folder in which it was trained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ahnn.contents import read_plain
from ahnn.errors import UserError

FILES = ("path", "stations", "gravity")
"""Keys of `system` that name files."""


def from_its_folder(system: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the node `system` of a run, with files that are not here but where the run was trained.

    Args:
        system: node of the configuration.
        folder: folder of the run; Hydra recorded the working directory of the training in it.
    """
    named = {key: system[key] for key in FILES if system.get(key)}
    if not str(named.get("gravity", "")).endswith(".gfc"):  # the name of an installed field
        named.pop("gravity", None)
    origin = _working_directory(folder) if named else None
    if origin is None:
        return system
    return system | {key: _found(value, origin) for key, value in named.items()}


def _found(value: Any, origin: Path) -> Any:
    if isinstance(value, list):
        return [_found(one, origin) for one in value]
    there = origin / str(value)
    return str(there) if not Path(str(value)).exists() and there.is_file() else value


def _working_directory(folder: Path) -> Path | None:
    """Return the working directory of a training; None if the run folder does not tell."""
    try:
        about: Any = read_plain(folder / ".hydra" / "hydra.yaml")
    except UserError:
        return None
    for key in ("hydra", "runtime", "cwd"):
        about = about.get(key) if isinstance(about, dict) else None
    return Path(about) if isinstance(about, str) else None
