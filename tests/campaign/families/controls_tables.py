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

from .controls_changes import BASE, START, TIMES, VALUES, changes, parts
from .damage import damaged
from .doors import answered, enter, taken
from .pushed_body import FREE, SPACE, Table, written
from .scales import table_of

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
    with taken(expected != "refused"):
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
    assert not early or "are held until the end" in said or len(table.times) == 1, (
        "held until the end without a word"
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
