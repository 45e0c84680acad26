"""Tables of controls at `ahnn.predict`: what comes out is the motion in closed form under what they say, or one refusal.

A change of the table leaves the controls as they are (`same`), makes others that are known (a `Table`), is a refusal
(`refused`), or is a word on standard error with the same controls (`word`).
"""

from __future__ import annotations

import copy
import os
import shutil
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import yaml

from .damage import damaged
from .doors import answered, enter
from .pushed_body import FREE, SPACE, Table, written
from .scales import table_of

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
BINARY = [b"", b"\n\n", b"t,u,w", bytes(range(256)) * 4, b"PK\x03\x04" + bytes(90), b"PAR1" + bytes(90), b"\x1f\x8b" + bytes(90),
          b"\x93NUMPY" + bytes(90), b"t,u,w\n0,1,\xff\n", b"[1,2]", b"{\"t\": 0}", b"<xml/>", b"CCSDS_OEM_VERS = 2.0\n"]  # fmt: skip
NUMBERS = {
    "[1,0.5]": "same", "[1,5e-1]": "same", "[1.0,.5]": "same", "[1,0.5,0]": "refused", "[1]": "refused", "[]": "refused",
    "1": "refused", "[1,.nan]": "refused", "[1,.inf]": "refused", "[1,nan]": "refused", "[1,x]": "refused",
    "[[1,0.5]]": "refused", "{u: 1, w: 0.5}": "refused", "null": "refused", "true": "refused", "[true,false]": "refused",
    "[1e200,0]": "refused", "[1,1e151]": "refused", "''": "refused", ".": "refused", "/dev/null": "refused",
    "/dev/zero": "refused", "none.csv": "refused", "[1,": "refused", "1,0.5": "refused", "-": "refused",
    "[1,0.5": "refused", "99999999999999999999999": "refused", "[1,'0.5']": "refused",
}  # fmt: skip
"""What a command line may hold in place of a file; `same` where it is the first row, held."""


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


def cases(draw, folder):
    """Yield a change of the table, something in its place, a damage, or another place."""
    made, free = written(folder / "pushed"), written(folder / "free", FREE)
    turned = written(folder / "turned", SPACE._replace(controls=("w", "u")))
    known, places = changes(), ["link", "pipe", "folder", "gone", "a link to nowhere", "unreadable"]
    kinds = ["change"] * 6 + ["numbers"] * 2 + ["binary", "damage", "place", "model"]
    while True:
        place, kind = Path(tempfile.mkdtemp(dir=folder)), draw.choice(kinds)
        if kind == "change":
            name, act, expected = draw.choice(known)
            form = (
                draw.choice(["csv", "csv", "txt", "parquet"])
                if expected == "same" and name in WHOLE
                else "csv"
            )
            yield f"{form} {name}", partial(changed, place, made, form, act, expected)
        elif kind == "numbers":
            text = draw.choice(list(NUMBERS))
            yield f"controls={text}", partial(given, place, made, text, NUMBERS[text])
        elif kind == "binary":
            content = draw.choice(BINARY)
            yield f"bytes {content[:20]!r}", partial(bytes_of, place, made, content)
        elif kind == "damage":
            what, content = damaged(draw, text_of(parts()))
            yield f"damage, {what}", partial(bytes_of, place, made, content, damage=True)
        elif kind == "place":
            where = draw.choice(places)
            yield where, partial(placed, place, made, where)
        else:
            words = draw.choice(
                [
                    (free, "none"),
                    (free, "table"),
                    ([made, free], "table"),
                    ([made, turned], "table"),
                    (turned, "table"),
                ]
            )
            yield f"model {words[0]}, {words[1]}", partial(other, place, *words)


WHOLE = {"nothing", "other order", "no unit", "capitals of the time", "minutes", "milliseconds", "many rows"}
"""Changes that a Parquet file can have, too."""


def text_of(p: dict) -> bytes:
    """Return the content of a table."""
    lines = [p["mark"].join(row) for row in (p["head"], *p["rows"])]
    return (p["end"].join(lines) + p["end"]).encode()


def run_of(place: Path, run: Path | list[Path], controls: object) -> tuple[int, str]:
    """Predict under controls into `place/o.csv`."""
    runs = run if isinstance(run, Path) else "[" + ",".join(map(str, run)) + "]"
    more = [] if controls is None else [f"controls={controls}"]
    return enter(
        place,
        "predict",
        f"run={runs}",
        f"start={[*START]}",
        "duration=2",
        "step=0.25",
        f"output={place}/o.csv",
        *more,
    )


def held(place: Path, code: int, said: str, expected: object) -> None:
    """Hold what came of a prediction against what should have come."""
    answered(code, said)
    assert expected != "refused", f"accepted; it says {said[-200:]!r}"
    assert expected != "word" or "used" in said or "convert" in said, (
        f"no word of what is not used: {said[-300:]!r}"
    )
    table = expected if isinstance(expected, Table) else BASE
    _, found = table_of(place / "o.csv")
    at = 0.25 * np.arange(9)
    truth = table.moved(at, START) / [1, 1.5]  # outputs are velocities
    seen = found[:, [2, 3]]
    size = np.abs(truth).max(axis=0) + 1e-12
    worst = float((np.abs(seen - truth) / size).max())
    assert worst < 1e-9, f"another motion, by {worst:.1e}: {said[-200:]!r}"
    early = table.times[-1] < 2.0 - 1e-9
    assert not early or "are held to the end" in said or len(table.times) == 1, (
        "held to the end without a word"
    )


def changed(place, run, form, act, expected) -> None:
    """Predict under a changed table."""
    p = copy.deepcopy(parts())
    act(p)
    path = place / f"c.{form}"
    if form == "parquet":
        columns = {name: [float(row[k]) for row in p["rows"]] for k, name in enumerate(p["head"])}
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    else:
        path.write_bytes(text_of(p))
    if p["sidecar"] is not None:
        path.with_suffix(".yaml").write_text(p["sidecar"])
    held(place, *run_of(place, run, path), expected)


def given(place, run, text, expected) -> None:
    """Predict under what stands in place of a file."""
    same = Table(TIMES[:1], VALUES[:1]) if expected == "same" else expected
    code, said = run_of(place, run, text)
    held(place, code, said, same)


def bytes_of(place, run, content, *, damage: bool = False) -> None:
    """Predict under a file with these bytes; damaged numbers may be numbers, of which a finite path comes."""
    (place / "c.csv").write_bytes(content)
    code, said = run_of(place, run, place / "c.csv")
    answered(code, said)
    assert damage, "accepted"
    assert np.isfinite(table_of(place / "o.csv")[1][:, 1:4]).all(), "no finite states"


def placed(place, run, where) -> None:
    """Predict under a table that is no plain file."""
    path = place / "c.csv"
    if where == "pipe":
        os.mkfifo(path)
    elif where == "folder":
        path.mkdir()
    elif where == "a link to nowhere":
        path.symlink_to(place / "none")
    elif where == "link":
        (place / "d.csv").write_bytes(text_of(parts()))
        path.symlink_to(place / "d.csv")
    elif where == "unreadable":
        path.write_bytes(text_of(parts()))
        path.chmod(0)
    root = where == "unreadable" and os.access(path, os.R_OK)
    held(place, *run_of(place, run, path), "same" if where == "link" or root else "refused")


def other(place, run, what) -> None:
    """Predict with a model that takes none, other ones, or with several runs."""
    path = place / "c.csv"
    path.write_bytes(text_of(parts()))
    single = isinstance(run, Path)
    if not single:
        run = [Path(shutil.copytree(one, place / one.name)) for one in run]
    code, said = run_of(place, run, path if what == "table" else None)
    if single and run.name == "free" and what == "none":
        held(place, code, said, Table(TIMES[:1], 0 * VALUES[:1]))
    elif single and run.name == "turned":  # its matrix is that of u and w, by their places
        held(place, code, said, BASE._replace(values=VALUES[:, ::-1]))
    else:
        held(place, code, said, "refused")
