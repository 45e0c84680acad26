"""YAML sidecar that describes the columns of a data file: `orbits.yaml` for `orbits.csv`."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ahnn.arguments import nearest
from ahnn.contents import plain_yaml
from ahnn.data.files.content import CANONICAL
from ahnn.data.files.table import Header, Place
from ahnn.data.files.unit_suffixes import with_suffixes
from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.manifest import require_own

SUFFIXES = (".yaml", ".yml")
TABLES = (".csv", ".txt", ".parquet", ".jsonl", ".json")
"""Extensions of tables that a sidecar describes."""
KEYS = ("units", "columns", "frame", "controls", "objects", "mass")
OTHERWISE = "If it is not the sidecar of the data file of the same name, rename one of them"
"""Remedy for a file that describes something else."""
WIDTH = 110
"""Width of remarks."""
LINEAR = "linear"
BETWEEN = ("held", LINEAR)
"""Allowed behaviours of controls between samples."""


class Sidecar(NamedTuple):
    """Content of a sidecar.

    Attributes:
        units: units by column name.
        columns: column names by role.
        frame: reference frame of the positions.
        controls: behaviour between samples, one of `BETWEEN`.
        objects: names of satellites by their identifiers, such as {2026-001A: MYGTO}.
        mass: `CANONICAL` for momenta that are not mass times velocity; "" otherwise.
    """

    units: dict[str, str] = {}  # noqa: RUF012 - never written to
    columns: dict[str, Any] = {}  # noqa: RUF012 - never written to
    frame: str = ""
    controls: str = BETWEEN[0]
    objects: dict[str, str] = {}  # noqa: RUF012 - never written to
    mass: str = ""


def beside(path: Path) -> Path:
    """Return the path of a data file's sidecar, or the path that it would have."""
    names = [path.with_suffix(suffix) for suffix in SUFFIXES]
    return next((name for name in names if name.is_file()), names[0])


def parse(text: str, file: str) -> Sidecar:
    """Parse the text of a sidecar.

    Raises:
        UserError: not YAML, a key other than `KEYS`, or an invalid value.
    """
    try:
        content = plain_yaml(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        Place(file).refuse("YAML", " ".join(str(error).split()))
    given: dict[Any, Any] = content if isinstance(content, dict) else {str(content): None}
    for key, value in given.items():
        if key not in KEYS:
            Place(file).refuse(f"keys {', '.join(KEYS)}", repr(key) + nearest(str(key), KEYS), OTHERWISE)
        if key == "mass" and value != CANONICAL:
            Place(file).refuse(f"mass: {CANONICAL}", repr(value), "Give a number as system.mass")
        if not isinstance(value, str if key in ("frame", "controls", "mass") else dict):
            Place(file).refuse(f"{key}: {'a name' if key == 'frame' else 'names with values'}", repr(value))
        if key == "controls" and value not in BETWEEN:
            Place(file).refuse(f"controls: {' or '.join(BETWEEN)}", repr(value))
    plain = {
        key: {str(name): str(value) for name, value in given.get(key, {}).items()}
        for key in ("units", "objects")
    }
    return Sidecar(**{**given, **plain})


def with_units(header: Header, sidecar: Sidecar, place: Place) -> Header:
    """Add the units of a sidecar to a header; without a sidecar names may end with units.

    Raises:
        UserError: a missing column, or a unit that contradicts the header.
    """
    header = header if sidecar.units or sidecar.columns else with_suffixes(header)
    units = dict(zip(header.names, header.units, strict=True))
    for name, text in sidecar.units.items():
        if name not in units:
            place.refuse(f"a column {name!r} (units)", ", ".join(header.names) + nearest(name, header.names))
        if units[name] not in (None, text):
            remedy = "State it once"
            place._replace(column=name).refuse(f"[{text}], as in the sidecar", f"[{units[name]}]", remedy)
        units[name] = text
    return Header(header.names, tuple(units.values()))


def written(path: Path, said: Sidecar, remarks: Iterable[str] = ()) -> bytes:
    """Return the sidecar of an output file as bytes, with remarks on the file as comments."""
    about = f"# Units, columns and frame of {path.name}\n"
    for remark in remarks:
        plain = "".join(sign if sign.isprintable() or sign.isspace() else "?" for sign in remark)
        about += "".join(f"# {line}\n" for line in textwrap.wrap(plain, WIDTH))
    usual = {"controls": BETWEEN[0], "objects": {}, "mass": ""}.items()
    plain = {key: value for key, value in said._asdict().items() if (key, value) not in usual}
    return f"{about}{yaml.safe_dump(plain, sort_keys=False)}".encode()


def require_place(path: Path) -> None:
    """Check that the sidecar of an output overwrites neither a foreign file nor that of another table.

    Raises:
        UserError: it does.
    """
    require_own([beside(path)], "output")
    others = [path.with_suffix(suffix) for suffix in TABLES if path.suffix != suffix]
    if beside(path).exists() and (taken := [other.name for other in others if other.is_file()]):
        message = (
            f"output: expected a name of its own, since {beside(path).name} describes {taken[0]}; received "
            f"{path}. Choose another name"
        )
        raise UserError(message)


def write(path: Path, said: Sidecar, remarks: Iterable[str] = ()) -> None:
    """Write the sidecar of a file, with remarks on the file as comments."""
    write_atomically(path.with_suffix(SUFFIXES[0]), written(path, said, remarks))
