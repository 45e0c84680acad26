"""Fields of tables and their sidecars: legal, illegal, empty, doubled or missing; units by a table of our own."""

from __future__ import annotations

import copy
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from .readings import READERS, Change, held, nothing

ILLEGAL = ["abc", "1_000", "0x10", "inf", "-inf", "1e999", "1.2.3", "--1", "None", "1e", "true"]
MISSING = ["", "nan", "NA", "NaN"]
RATES = {"t": 0, "q": 1, "v": 2}


def table() -> dict:
    """Return the parts of a sound table: two swings, eighteen samples each."""
    rows = []
    for name, size in (("a", 1.0), ("b", 1.5)):
        rows += [[name, t, size * np.cos(t), -size * np.sin(t)] for t in (0.125 * k for k in range(18))]
    cells = [[name, *map(repr, map(float, numbers))] for name, *numbers in rows]
    return {
        "head": ["id", "t [s]", "q [m]", "v [m/s]"],
        "rows": cells,
        "mark": ",",
        "sidecar": None,
        "end": "\n",
    }


def head(column: int, text: str):
    """Return a change of the header."""

    def change(p: dict) -> None:
        p["head"][column] = text

    return change


def heads(*texts: str):
    """Return a change of the whole header."""

    def change(p: dict) -> None:
        p["head"] = list(texts)

    return change


def cell(row: int, column: int, text: str):
    """Return a change of a cell."""

    def change(p: dict) -> None:
        p["rows"][row][column] = text

    return change


def beside(bare: bool = True, **content: object):
    """Return a change that puts a sidecar beside the table, whose header then has names alone."""

    def change(p: dict) -> None:
        p["sidecar"] = yaml.safe_dump(content)
        if bare:
            p["head"] = [text.partition(" ")[0] for text in p["head"]]

    return change


def sidecar(text: str):
    """Return a change that puts that text beside the table."""
    return lambda p: p.update(sidecar=text, head=["id", "t", "q", "v"])


def scaled(time: float = 1.0, position: float = 1.0, velocity: float = 1.0):
    """Return what becomes of numbers whose units are so many times larger."""
    return lambda times, states: (times * time, states * [position, velocity])


def without(row: int):
    """Return what is left where a sample is missing."""
    return lambda times, states: (np.delete(times, row), np.delete(states, row, axis=0))


def number(row: int, column: int, value: float):
    """Return what becomes of a cell with another number."""

    def expected(times, states):
        states[row, column - 2] = value
        return times, states

    return expected


UNITS = {"units": {"t": "s", "q": "m", "v": "m/s"}}
ROLES = {"columns": {"time": "t", "id": "id", "positions": ["q"], "velocities": ["v"]}}


def changes() -> list[Change]:
    """Return all changes."""
    return [*lines(), *samples(), *names(), *units(), *sidecars(), *roles(), *sidecar_texts(), *numerals()]


def lines() -> list[Change]:
    """Return changes of the lines of the file and their marks."""
    return [
        ("nothing", nothing, "same"),
        ("semicolons", lambda p: p.update(mark=";"), "same"),
        ("tabs", lambda p: p.update(mark="\t"), "same"),
        ("CRLF", lambda p: p.update(end="\r\n"), "same"),
        ("CR alone", lambda p: p.update(end="\r"), "same"),
        ("a remark", lambda p: p["rows"].insert(3, ["# remark"]), "same"),
        ("quotes", cell(4, 2, '"' + repr(float(np.cos(0.5))) + '"'), "same"),
        ("an open quote", cell(4, 2, '"1.0'), "refused"),
    ]  # fmt: skip


def samples() -> list[Change]:
    """Return changes of rows that are missing, doubled, short or out of order."""
    return [
        ("a row twice", lambda p: p["rows"].insert(5, p["rows"][4]), "refused"),
        ("rows in reverse", lambda p: p["rows"].reverse(), "refused"),
        ("mixed trajectories", lambda p: p["rows"].sort(key=lambda row: float(row[1])), "same"),
        ("a row less", lambda p: p["rows"].pop(7), without(7)),
        ("no rows", lambda p: p["rows"].clear(), "refused"),
        ("a short row", lambda p: p["rows"][3].pop(), "refused"),
        ("a long row", lambda p: p["rows"][3].append("1"), "refused"),
        ("a missing time", cell(4, 1, ""), "refused"),
        ("a time that goes back", cell(4, 1, "0.1"), "refused"),
        ("an empty id", cell(4, 0, ""), "said"),
        ("an id of blanks", cell(4, 0, "  "), "said"),
    ]  # fmt: skip


def names() -> list[Change]:
    """Return changes of the names of columns."""
    return [
        ("no id", lambda p: [p["head"].pop(0), *(row.pop(0) for row in p["rows"])], "refused"),
        ("two times", heads("id", "t [s]", "time [s]", "v [m/s]"), "refused"),
        ("two ids", heads("id", "t [s]", "q [m]", "trajectory"), "word"),
        ("a name twice", heads("id", "t [s]", "q [m]", "q [m]"), "refused"),
        ("an empty name", heads("id", "t [s]", "q [m]", ""), "refused"),
        ("a number as name", heads("id", "t [s]", "1.0", "v [m/s]"), "refused"),
    ]  # fmt: skip


def units() -> list[Change]:
    """Return changes of the units in the header."""
    return [
        ("minutes", head(1, "t [min]"), "refused"),
        ("minutes of both", heads("id", "t [min]", "q [m]", "v [m/min]"), scaled(60, 1, 1 / 60)),
        ("hours of both", heads("id", "t [h]", "q [m]", "v [m/h]"), scaled(3600, 1, 1 / 3600)),
        ("kilometres", heads("id", "t [s]", "q [km]", "v [km/s]"), scaled(1, 1e3, 1e3)),
        ("centimetres", heads("id", "t [s]", "q [cm]", "v [cm/s]"), scaled(1, 1e-2, 1e-2)),
        ("milliseconds", heads("id", "t [ms]", "q [m]", "v [m/ms]"), scaled(1e-3, 1, 1e3)),
        ("in parentheses", heads("id", "t (s)", "q (km)", "v (km/s)"), scaled(1, 1e3, 1e3)),
        ("another unit of the velocity", head(3, "v [km/s]"), "refused"),
        ("an unknown unit", head(2, "q [furlong]"), "refused"),
        ("a unit of mass", head(2, "q [kg]"), "refused"),
        ("a unit of time", head(2, "q [s]"), "refused"),
        ("no unit of one", head(2, "q"), "refused"),
        ("an empty unit", head(2, "q []"), "word"),
        ("upper case", heads("ID", "T [s]", "Q [m]", "V [m/s]"), "same"),
    ]  # fmt: skip


def sidecars() -> list[Change]:
    """Return changes of units, frames and keys beside the table."""
    return [
        ("units beside", beside(**UNITS), "same"),
        ("kilometres beside", beside(units={"t": "s", "q": "km", "v": "km/s"}), scaled(1, 1e3, 1e3)),
        ("minutes beside", beside(units={"t": "min", "q": "m", "v": "m/min"}), scaled(60, 1, 1 / 60)),
        ("a frame beside", beside(**UNITS, frame="GCRF, EARTH"), "word"),
        ("a frame of one's own", beside(**UNITS, frame="mine"), "word"),
        ("an empty frame", beside(**UNITS, frame=""), "same"),
        ("a frame that is a number", beside(**UNITS, frame=7), "refused"),
        ("a unit of no column", beside(units={**UNITS["units"], "z": "m"}), "refused"),
        ("a unit that is a number", beside(units={**UNITS["units"], "q": 7}), "refused"),
        ("a unit NaN", beside(units={**UNITS["units"], "q": float("nan")}), "refused"),
        ("a unit null", beside(units={**UNITS["units"], "q": None}), "refused"),
        ("units that are a list", beside(units=["s", "m"]), "refused"),
        ("another unit than the header", beside(bare=False, units={"q": "km"}), "refused"),
        ("an unknown key", beside(**UNITS, mass=2.0), "refused"),
    ]  # fmt: skip


def roles() -> list[Change]:
    """Return changes of what columns are, beside the table."""

    def columns(**others: object):
        return beside(**UNITS, columns={**ROLES["columns"], **others})

    known = {"time": "t", "positions": ["q"]}
    return [
        ("roles beside", beside(**UNITS, **ROLES), "same"),
        ("an unknown role", columns(sensor="q"), "refused"),
        ("a role of no column", columns(positions=["z"]), "refused"),
        ("no time beside", beside(**UNITS, columns={"positions": ["q"]}), "refused"),
        ("a role that is null", columns(velocities=None), "refused"),
        ("a role that is empty", columns(velocities=[]), "word"),
        ("a column twice", columns(velocities=["q"]), "refused"),
        ("momenta beside", beside(**UNITS, columns={**known, "id": "id", "momenta": ["v"]}), "refused"),
        ("no id beside", beside(**UNITS, columns={**known, "velocities": ["v"]}), "refused"),
    ]  # fmt: skip


def sidecar_texts() -> list[Change]:
    """Return changes of sidecars that are no sidecars."""
    return [
        ("a key twice beside", sidecar("units: {t: s, q: m, v: m/s}\nunits: {t: s, q: km, v: km/s}\n"), "refused"),
        ("a unit twice beside", sidecar("units: {t: s, q: m, v: m/s, q: km}\n"), "refused"),
        ("no YAML", sidecar("units: {t: s"), "refused"),
        ("an empty sidecar", sidecar(""), "word"),
        ("a list beside", sidecar("- units\n"), "refused"),
        ("a text beside", sidecar("units"), "refused"),
        ("two documents beside", sidecar("units: {t: s, q: m, v: m/s}\n---\nframe: GCRF\n"), "refused"),
        ("an object beside", sidecar("units: !!python/object/apply:os.system [true]\n"), "refused"),
    ]  # fmt: skip


def numerals() -> list[Change]:
    """Return changes of how numbers are spelled."""
    return [
        ("exponents", cell(4, 2, "1e-1"), number(4, 2, 0.1)),
        ("an exponent D", cell(4, 2, "1D0"), "word"),
        ("a plus", cell(4, 2, "+0.5"), number(4, 2, 0.5)),
        *((f"{'tqv'[c - 1]} {text}", cell(9, c, text), "refused") for c in (1, 2, 3) for text in ILLEGAL),
        *((f"{'qv'[c - 2]} {text or 'empty'}", cell(9, c, text), without(9)) for c in (2, 3) for text in MISSING),
    ]  # fmt: skip


def cases(draw, folder):
    """Yield a change, a format and a door."""
    known = changes()
    while True:
        place, door = Path(tempfile.mkdtemp(dir=folder)), draw.choice(list(READERS))
        name, change, expected = draw.choice(known)
        kind = draw.choice(["csv", "csv", "txt"])
        yield f"{kind} {name}, {door}", partial(read, READERS[door], place, kind, change, expected)


def read(reader, place, kind, change, expected) -> None:
    """Read the sound table and the changed one."""
    found = []
    for name, act in (("a", nothing), ("b", change)):
        (place / name).mkdir()
        p = copy.deepcopy(table())
        act(p)
        path = place / name / f"mine.{kind}"
        lines = [p["mark"].join(row) for row in (p["head"], *p["rows"])]
        path.write_bytes((p["end"].join(lines) + p["end"]).encode())
        if p["sidecar"] is not None:
            path.with_suffix(".yaml").write_text(p["sidecar"])
        found.append(reader(path))
    held(expected, *found)
