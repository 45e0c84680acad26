"""Changes of a table of controls, and what must become of a prediction under it."""

from __future__ import annotations

import numpy as np
import yaml

from .pushed_body import Table

TIMES = np.array([0.0, 0.3, 0.5, 1.1, 1.7, 2.0])
VALUES = np.array([[1.0, 0.5], [-2.0, 1.5], [0.25, 0.0], [3.0, -1.0], [-0.5, 2.0], [1.5, 1.0]])
BASE, START = Table(TIMES, VALUES), (0.3, -0.2)
ILLEGAL = [
    "abc",
    "1_000",
    "0x10",
    "inf",
    "-inf",
    "1e999",
    "1e151",
    "1.2.3",
    "--1",
    "None",
    "true",
    "",
    "nan",
    "NA",
]


def parts() -> dict:
    """Return the parts of a sound table."""
    rows = [[*map(repr, map(float, row))] for row in np.column_stack((TIMES, VALUES))]
    return {
        "head": ["t [s]", "u", "w"],
        "rows": rows,
        "mark": ",",
        "end": "\n",
        "sidecar": None,
        "kind": "csv",
    }


def head(*texts: str):
    """Return a change of the header."""
    return lambda p: p.update(head=[*texts])


def cell(row: int, column: int, text: str):
    """Return a change of a cell."""

    def change(p: dict) -> None:
        p["rows"][row][column] = text

    return change


def beside(text: str | None = None, head: tuple[str, ...] = ("t", "u", "w"), **content: object):
    """Return a change that puts a sidecar beside the table."""
    return lambda p: p.update(sidecar=yaml.safe_dump(content) if text is None else text, head=[*head])


def column(at: int, name: str, text: str):
    """Return a change that adds a column."""

    def change(p: dict) -> None:
        for row, cell in zip((p["head"], *p["rows"]), (name, *[text] * len(p["rows"])), strict=True):
            row.insert(at, cell)

    return change


def swapped(p: dict) -> None:
    """Put the columns into another order."""
    for row in (p["head"], *p["rows"]):
        row[:] = [row[2], row[0], row[1]]


def times(act) -> tuple:
    """Return a change of the times, and the controls that follow."""

    def change(p: dict) -> None:
        for row in p["rows"]:
            row[0] = repr(float(act(float(row[0]))))

    return change, BASE._replace(times=act(TIMES))


def rows(*chosen: int) -> tuple:
    """Return a change that keeps some rows, and the controls that follow."""
    keep = list(chosen)
    return lambda p: p.update(rows=[p["rows"][k] for k in keep]), Table(TIMES[keep], VALUES[keep])


def many(p: dict) -> None:
    """Cut each row into a thousand that say the same."""
    ends = [*TIMES[1:], 2.5]
    made = []
    for row, begin, end in zip(p["rows"], TIMES, ends, strict=True):
        made += [[repr(float(t)), *row[1:]] for t in np.linspace(begin, end, 500, endpoint=False)]
    p["rows"] = made


def scaled(size: float):
    """Return a change of the values, and the controls that follow."""

    def change(p: dict) -> None:
        for row in p["rows"]:
            row[1:] = [repr(float(cell) * size) for cell in row[1:]]

    return change, BASE._replace(values=VALUES * size)


def changes() -> list[tuple]:
    """Return all changes: name, act, and what must become of it."""
    linear = BASE._replace(linear=True)
    nudged = BASE._replace(times=TIMES + np.array([0, 0, 1e-13, 0, 0, 0]))
    return [
        ("nothing", lambda _: None, "same"), ("semicolons", lambda p: p.update(mark=";"), "same"),
        ("tabs", lambda p: p.update(mark="\t"), "same"), ("CRLF", lambda p: p.update(end="\r\n"), "same"),
        ("a remark", lambda p: p["rows"].insert(2, ["# remark"]), "same"), ("other order", swapped, "same"),
        ("quotes", cell(2, 1, '"0.25"'), "same"), ("an open quote", cell(2, 1, '"0.25'), "refused"),
        ("capitals of the time", head("TIME [s]", "u", "w"), "same"), ("no unit", head("t", "u", "w"), "same"),
        ("in parentheses", head("t (s)", "u", "w"), "same"), ("blanks", head(" t [s] ", "  u", "w  "), "same"),
        ("capitals", head("t [s]", "U", "W"), "refused"), ("another name", head("t [s]", "u", "v"), "refused"),
        ("one name twice", head("t [s]", "u", "u"), "refused"), ("two times", head("t [s]", "time", "w"), "refused"),
        ("no time", head("s", "u", "w"), "refused"), ("numbers as names", head("0", "1", "2"), "refused"),
        ("an empty name", head("t [s]", "u", ""), "refused"), ("a time twice", column(0, "time [s]", "1"), "refused"),
        ("another column", column(3, "note", "7"), "word"), ("an id", column(0, "id", "a"), "word"),
        ("a text column", column(1, "note", "abc"), "word"), ("a deviation", column(2, "sd_u", "0.1"), "word"),
        ("a unit of a control", head("t [s]", "u [N]", "w [kN]"), "word"), ("an empty unit", head("t []", "u", "w"), "refused"),
        ("metres", head("t [m]", "u", "w"), "refused"), ("furlongs", head("t [furlong]", "u", "w"), "refused"),
        ("minutes", lambda p: [head("t [min]", "u", "w")(p), times(lambda t: t / 60)[0](p)], "same"),
        ("milliseconds", lambda p: [head("t [ms]", "u", "w")(p), times(lambda t: 1000 * t)[0](p)], "same"),
        ("minutes of others", head("t [min]", "u", "w"), BASE._replace(times=60 * TIMES)),
        ("begins earlier", *times(lambda t: t - 0.4)), ("begins long before", *times(lambda t: t * 1e9 - 1e9)),
        ("begins later", times(lambda t: t + 0.1)[0], "refused"), ("begins after the end", times(lambda t: t + 9)[0], "refused"),
        ("begins a little later", times(lambda t: t + 1e-3)[0], "refused"), ("begins at rounding", times(lambda t: t + 1e-14)[0], "same"),
        ("reversed", lambda p: p["rows"].reverse(), "refused"), ("a row twice", lambda p: p["rows"].insert(2, p["rows"][1]), "refused"),
        ("two rows swapped", lambda p: p["rows"].insert(1, p["rows"].pop(3)), "refused"), ("a time again", cell(3, 0, "0.5"), "refused"),
        ("a time back", cell(3, 0, "0.1"), "refused"), ("at a time of the output", *rows(0, 1, 2, 3, 4, 5)),
        ("a jump beside one of the output", lambda p: cell(2, 0, "0.5000000000001")(p), nudged),
        ("a jump within rounding", lambda p: p["rows"].insert(3, ["0.5000000000000002", "0.25", "0.0"]), "same"),
        ("ends early", *rows(0, 1, 2)), ("one row", *rows(0)), ("no rows", lambda p: p["rows"].clear(), "refused"),
        ("a short row", lambda p: p["rows"][2].pop(), "refused"), ("a long row", lambda p: p["rows"][2].append("1"), "refused"),
        ("many rows", many, "same"), ("huge", *scaled(1e140)), ("tiny", *scaled(1e-300)), ("none acts", *scaled(0.0)),
        ("dates", lambda p: [cell(k, 0, f"2024-03-01T00:00:0{k}")(p) for k in range(6)], "refused"),
        ("times of the day", lambda p: [cell(k, 0, f"00:00:0{k}")(p) for k in range(6)], "refused"),
        ("linear", beside(controls="linear"), linear), ("held", beside(controls="held"), "same"),
        ("linear, ends early", lambda p: [beside(controls="linear")(p), rows(0, 1, 2)[0](p)], rows(0, 1, 2)[1]._replace(linear=True)),
        ("linear, begins earlier", lambda p: [beside(controls="linear")(p), times(lambda t: t - 0.4)[0](p)],
         linear._replace(times=TIMES - 0.4)),
        ("cubic", beside(controls="cubic"), "refused"), ("linear of a list", beside(controls=["linear"]), "refused"),
        ("linear is null", beside(controls=None), "refused"), ("minutes beside", beside(units={"t": "min"}), BASE._replace(times=60 * TIMES)),
        ("another unit than the header", beside(head=("t [s]", "u", "w"), units={"t": "min"}), "refused"),
        ("a unit of no column", beside(units={"x": "s"}), "refused"), ("a unit that is NaN", beside(units={"t": float("nan")}), "refused"),
        ("columns beside", beside(columns={"time": "t", "controls": ["u", "w"]}), "refused"), ("a frame", beside(frame="GCRF"), "refused"),
        ("an unknown key", beside(mass=2), "refused"), ("no YAML", beside("units: {t: s"), "refused"), ("an empty sidecar", beside(""), "refused"),
        ("an object", beside("units: !!python/object/apply:os.system [true]\n"), "refused"), ("a list beside", beside("- units\n"), "refused"),
        *((f"{'tuw'[c]} {text or 'empty'}", cell(2, c, text), "refused") for c in (0, 1, 2) for text in ILLEGAL),
    ]  # fmt: skip
