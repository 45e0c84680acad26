"""Columns of Parquet files: types, units in the metadata of fields, missing values, time stamps."""

from __future__ import annotations

import datetime
import decimal
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from .fields_tables import number, scaled, table, without
from .readings import READERS, Change, held, nothing

UNITS = {"t": "s", "q": "m", "v": "m/s"}
START = datetime.datetime(2024, 3, 1, 12, tzinfo=datetime.UTC)


def columns() -> dict:
    """Return the columns of the sound table, and their units."""
    rows = table()["rows"]
    made = {
        name: [row[k] if k == 0 else float(row[k]) for row in rows]
        for k, name in enumerate(("id", "t", "q", "v"))
    }
    return {"columns": made, "types": {}, "units": dict(UNITS)}


def typed(name: str, kind: str, act=lambda value: value):
    """Return a change of the type of a column."""

    def change(p: dict) -> None:
        p["types"][name] = kind
        p["columns"][name] = [act(value) for value in p["columns"][name]]

    return change


def cell(row: int, name: str, value: object):
    """Return a change of a cell."""

    def change(p: dict) -> None:
        p["columns"][name][row] = value

    return change


def units(**given: str):
    """Return a change of units."""
    return lambda p: p["units"].update(given)


def renamed(name: str, other: str):
    """Return a change of the name of a column."""

    def change(p: dict) -> None:
        p["columns"] = {other if key == name else key: value for key, value in p["columns"].items()}
        p["units"] = {other if key == name else key: value for key, value in p["units"].items()}

    return change


def stamped(p: dict) -> None:
    """Make time stamps of the times."""
    p["columns"]["t"] = [START + datetime.timedelta(seconds=value) for value in p["columns"]["t"]]
    p["units"].pop("t")


def local(p: dict) -> None:
    """Make time stamps of another zone of them, which are the same moments."""
    stamped(p)
    zone = datetime.timezone(datetime.timedelta(hours=5, minutes=30))
    p["columns"]["t"] = [value.astimezone(zone) for value in p["columns"]["t"]]
    p["types"]["t"] = "timestamp[us, tz=+05:30]"


def single(times: np.ndarray, states: np.ndarray) -> tuple:
    """Return what single precision leaves."""
    return times, states.astype(np.float32).astype(np.float64)


CHANGES: list[Change] = [
    ("nothing", nothing, "same"),
    ("float32", lambda p: [typed(name, "float32")(p) for name in "qv"], single),
    ("decimals", typed("q", "decimal128(38, 20)", lambda v: decimal.Decimal(f"{v:.18f}")), scaled()),
    ("texts", typed("q", "string", repr), "same"),
    ("large texts", typed("q", "large_string", repr), "same"),
    ("booleans", typed("q", "bool_", lambda v: v > 0), "refused"),
    ("lists", typed("q", "list", lambda v: [v]), "refused"),
    ("structs", typed("q", "struct", lambda v: {"a": v}), "refused"),
    ("bytes", typed("q", "binary", lambda v: repr(v).encode()), "refused"),
    ("durations", typed("q", "duration", lambda v: datetime.timedelta(seconds=v)), "refused"),
    ("whole ids", typed("id", "int64", lambda v: ord(v)), "same"),
    ("ids that are numbers", typed("id", "float64", lambda v: float(ord(v))), "same"),
    ("whole numbers", typed("q", "int64", round), "refused"),
    ("a number null", cell(9, "q", None), without(9)),
    ("a number NaN", cell(9, "q", float("nan")), without(9)),
    ("a number inf", cell(9, "q", float("inf")), "refused"),
    ("a time null", cell(9, "t", None), "refused"),
    ("a time NaN", cell(9, "t", float("nan")), "refused"),
    ("a time twice", cell(9, "t", 1.0), "refused"),
    ("an id null", cell(9, "id", None), "said"),
    ("an id empty", cell(9, "id", ""), "said"),
    ("another number", cell(9, "q", 0.5), number(9, 2, 0.5)),
    ("kilometres", units(q="km", v="km/s"), scaled(1, 1e3, 1e3)),
    ("minutes", units(t="min", v="m/min"), scaled(60, 1, 1 / 60)),
    ("an unknown unit", units(q="furlong"), "refused"),
    ("an empty unit", units(q=""), "word"),
    ("a unit of something else", units(q="kg"), "refused"),
    ("no unit of one", lambda p: p["units"].pop("q"), "refused"),
    ("another unit in the name", renamed("q", "q [km]"), "refused"),
    ("the unit in the name, too", renamed("q", "q [m]"), "same"),
    ("time stamps", stamped, scaled()),
    ("time stamps of another zone", local, scaled()),
    ("a name of blanks", renamed("q", " "), "refused"),
]  # fmt: skip


def written(path: Path, p: dict) -> None:
    """Write the columns."""
    import pyarrow
    import pyarrow.parquet

    arrays, fields = [], []
    for name, values in p["columns"].items():
        kind = p["types"].get(name)
        plain = kind in (None, "list", "struct", "binary", "duration", "decimal128(38, 20)") or "tz=" in kind
        array = pyarrow.array(values) if plain else pyarrow.array(values, getattr(pyarrow, kind)())
        if kind and "tz=" in kind:
            array = pyarrow.array(values, pyarrow.timestamp("us", tz="+05:30"))
        unit = p["units"].get(name)
        arrays.append(array)
        fields.append(pyarrow.field(name, array.type, metadata=None if unit is None else {"unit": unit}))
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields)), path)


def cases(draw, folder):
    """Yield a change and a door."""
    while True:
        name, change, expected = draw.choice(CHANGES)
        door, place = draw.choice(list(READERS)), Path(tempfile.mkdtemp(dir=folder))
        yield f"{name}, {door}", partial(read, READERS[door], place, change, expected)


def read(reader, place, change, expected) -> None:
    """Read the sound columns and the changed ones."""
    found = []
    for name, act in (("a", nothing), ("b", change)):
        (place / name).mkdir()
        p = columns()
        act(p)
        written(place / name / "mine.parquet", p)
        found.append(reader(place / name / "mine.parquet"))
    held(expected, *found)
