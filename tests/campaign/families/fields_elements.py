"""Fields of two-line element sets: the orbit changes as SGP4 itself says, or the set is refused.

The expectation is made by the package sgp4 from numbers, without its reader of lines.
"""

from __future__ import annotations

import copy
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from ahnn.errors import UserError

from .readings import READERS, Change, held, nothing


def set_of() -> dict:
    """Return the fields of an element set: a Molniya orbit of 2024, as columns and texts."""
    one = {0: "1", 2: "40296", 7: "U", 9: "14069A  ", 18: "24061.50000000", 33: " .00000123", 44: " 00000-0",
           53: " 12345-3", 62: "0", 64: "  999"}  # fmt: skip
    two = {0: "2", 2: "40296", 8: " 62.8000", 17: "120.0000", 26: "6800000", 34: "280.0000", 43: " 15.0000",
           52: " 2.00613000", 63: "12345"}  # fmt: skip
    return {
        "one": one,
        "two": two,
        "checksums": [None, None],
        "between": "",
        "before": "MOLNIYA\n",
        "times": 1,
    }


def element(line: str, column: int, text: str):
    """Return a change of a field."""

    def change(p: dict) -> None:
        p[line][column] = text.ljust(len(p[line][column]))[: len(p[line][column])]

    return change


ELEMENTS: list[Change] = [
    ("nothing", nothing, "same"),
    ("a wrong checksum", lambda p: p.update(checksums=["x", None]), "refused"),
    ("a wrong checksum of line 2", lambda p: p.update(checksums=[None, "x"]), "refused"),
    ("no name", lambda p: p.update(before=""), "same"),
    ("a remark", lambda p: p.update(before="# remark\n"), "same"),
    ("another catalogue number in line 2", element("two", 2, "40297"), "refused"),
    ("secret", element("one", 7, "S"), "same"),
    ("another designator", element("one", 9, "14070B"), "same"),
    ("another set number", element("one", 64, " 1000"), "same"),
    ("SGP4-XP", element("one", 62, "4"), "word"),
    ("another theory", element("one", 62, "1"), "word"),
    ("a set twice", lambda p: p.update(times=2), "word"),
    ("a line 2 without line 1", lambda p: p.update(before="2" + 68 * " " + "\n"), "word"),
    ("text between the lines", lambda p: p.update(between="a remark\n"), "same"),
    ("half a day later", element("one", 18, "24062.00000000"), "word"),
    ("a day 367", element("one", 18, "24367.50000000"), "refused"),
    ("a day 0", element("one", 18, "24000.50000000"), "refused"),
    *((f"{name} changed", element(line, column, text), "elements") for name, line, column, text in (
        ("inclination", "two", 8, " 63.4000"), ("node", "two", 17, "121.5000"), ("eccentricity", "two", 26, "7100000"),
        ("perigee", "two", 34, "270.0000"), ("anomaly", "two", 43, "180.0000"), ("motion", "two", 52, " 2.01000000"),
        ("drag", "one", 53, " 54321-2"))),
    *((f"{name} {text or 'empty'}", element(line, column, text), "refused")
      for name, line, column in (("inclination", "two", 8), ("eccentricity", "two", 26), ("motion", "two", 52),
                                 ("anomaly", "two", 43), ("epoch", "one", 18), ("drag", "one", 53))
      for text in ("", "abc", "nan", "inf")),
]  # fmt: skip


def spelled(p: dict) -> str:
    """Return the lines of a set with their checksums."""
    lines = []
    for name, given in zip(("one", "two"), p["checksums"], strict=True):
        text = list(" " * 68)
        for column, part in p[name].items():
            text[column : column + len(part)] = part
        line = "".join(text[:68])
        total = sum(int(sign) if sign.isdigit() else sign == "-" for sign in line) % 10
        lines.append(line + (str((total + 1) % 10) if given else str(total)))
    return p["times"] * (p["before"] + lines[0] + "\n" + p["between"] + lines[1] + "\n")


def by_sgp4(p: dict) -> np.ndarray:
    """Return states in m and m/s each minute, by the fields' own numbers."""
    from sgp4.api import WGS72, Satrec

    one, two, rad = p["one"], p["two"], np.pi / 180
    drag, sat = one[53], Satrec()
    days = (np.datetime64("2024-01-01") - np.datetime64("1949-12-31")).astype(int) + float(one[18][2:]) - 1
    drag = float(f"{drag[0].strip()}.{drag[1:6]}e{drag[6:]}")
    angles = [float(two[column]) * rad for column in (8, 34, 43, 17)]
    tilt, perigee, anomaly, node = angles
    motion = float(two[52]) * 2 * np.pi / 1440
    sat.sgp4init(
        WGS72, "i", 40296, days, drag, 0.0, 0.0, float(f"0.{two[26]}"), perigee, tilt, anomaly, motion, node
    )
    times = np.arange(11) / 1440
    codes, r, v = sat.sgp4_array(np.full(11, sat.jdsatepoch), sat.jdsatepochF + times)
    assert not codes.any()
    return 1000 * np.concatenate((r, v), axis=1)


def cases(draw, folder):
    """Yield a change and a door."""
    while True:
        place, door = Path(tempfile.mkdtemp(dir=folder)), draw.choice(list(READERS))
        name, change, expected = draw.choice(ELEMENTS)
        yield f"{name}, {door}", partial(elements, READERS[door], place, change, expected)


def elements(reader, place, change, expected) -> None:
    """Read the sound set and the changed one, ten minutes of each."""
    found, options = [], {"step": 60.0, "duration": 600.0}
    for name, act in (("a", nothing), ("b", change)):
        (place / name).mkdir()
        p = copy.deepcopy(set_of())
        act(p)
        path = place / name / "mine.tle"
        path.write_text(spelled(p))
        try:
            found.append(reader(path, **options))
        except UserError:
            if name == "a":
                raise AssertionError("a sound set is refused") from None
            raise
    if expected == "elements":
        states = by_sgp4(p)
        expected = lambda times, _: (times, states)  # noqa: E731
    held(expected, *found)
