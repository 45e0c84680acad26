"""The YAML beside a data file that says what its columns are: `orbits.yaml` beside `orbits.csv`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ahnn.arguments import nearest
from ahnn.data.files.plain import loaded
from ahnn.data.files.table import Header, Place

SUFFIXES = (".yaml", ".yml")
KEYS = ("units", "columns", "frame")


class Sidecar(NamedTuple):
    """What a sidecar says.

    Attributes:
        units: from names of columns to units.
        columns: from roles to names of columns.
        frame: in which the positions are given.
    """

    units: dict[str, str] = {}  # noqa: RUF012 - never written to
    columns: dict[str, Any] = {}  # noqa: RUF012 - never written to
    frame: str = ""


def beside(path: Path) -> Path:
    """Return where the sidecar of a data file is, if it has one."""
    names = [path.with_suffix(suffix) for suffix in SUFFIXES]
    return next((name for name in names if name.is_file()), names[0])


def parse(text: str, file: str) -> Sidecar:
    """Return a sidecar from its text.

    Raises:
        UserError: no YAML, or keys other than `units`, `columns` and `frame`.
    """
    try:
        content = loaded(text)
    except yaml.YAMLError as error:
        Place(file).refuse("YAML", " ".join(str(error).split()))
    given: dict[Any, Any] = content if isinstance(content, dict) else {str(content): None}
    for key, value in given.items():
        if key not in KEYS:
            Place(file).refuse(f"keys {', '.join(KEYS)}", repr(key) + nearest(str(key), KEYS))
        if not isinstance(value, str if key == "frame" else dict):
            Place(file).refuse(f"{key}: {'a name' if key == 'frame' else 'names with values'}", repr(value))
    units = {str(name): str(value) for name, value in given.get("units", {}).items()}
    return Sidecar(units, given.get("columns", {}), given.get("frame", ""))


def with_units(header: Header, sidecar: Sidecar, place: Place) -> Header:
    """Return a header with the units of a sidecar.

    Raises:
        UserError: a column that is not there, or another unit than the header has.
    """
    units = dict(zip(header.names, header.units, strict=True))
    for name, text in sidecar.units.items():
        if name not in units:
            place.refuse(f"a column {name!r} (units)", ", ".join(header.names) + nearest(name, header.names))
        if units[name] not in (None, text):
            remedy = "Say it once"
            place._replace(column=name).refuse(f"[{text}], as in the sidecar", f"[{units[name]}]", remedy)
        units[name] = text
    return Header(header.names, tuple(units.values()))
