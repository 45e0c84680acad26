"""Command line of orbit determination: `FILE.yaml [KEY=VALUE...]`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ahnn.cli.commandline import pair
from ahnn.cli.pairs import divided
from ahnn.contents import read_plain
from ahnn.errors import UserError, WrongUsage
from ahnn.jobs.determining import OrbitRequest
from ahnn.tracking.orbit_setup import setup_of

OWN = ("folder", "out")
"""Keys of the command in addition to the keys of the file."""


def read_orbit(arguments: list[str]) -> OrbitRequest:
    """Build the request of a command line.

    Raises:
        UserError: a missing file, an unknown or missing key, or a value of the wrong type.
    """
    paths, texts = divided(arguments, OWN)
    if len(paths) != 1:
        message = f"received: {' '.join(arguments) or 'nothing'}"
        raise WrongUsage(message)
    values, own = read_plain(paths[0], "the settings of an orbit determination"), dict[str, Any]()
    for key, value in map(pair, texts):
        if key in OWN:
            own[key] = Path(str(value)).expanduser()
            if not str(value):
                message = f"{key}: expected a folder; received none, as from an unset variable"
                raise UserError(message)
        else:
            put(values, key, value)
    folder = own.get("folder", paths[0].parent)
    if not folder.is_dir():
        message = f"folder: expected the folder of the measurements; received {folder}"
        raise UserError(message)
    return OrbitRequest(setup_of(values), folder, own.get("out"), paths[0].stem)


def put(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a value under a dotted key; raises UserError if a parent is not a mapping."""
    *above, last = key.split(".")
    place = values
    for part in above:
        below = place.get(part)
        if below is None:
            below = place[part] = {}
        if not isinstance(below, dict):
            message = f"{key}: expected keys below {part!r}; received {below!r} in the file"
            raise UserError(message)
        place = below
    place[last] = value
