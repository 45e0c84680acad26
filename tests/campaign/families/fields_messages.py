"""Fields of orbit messages: each is another legal value, an illegal one, empty, doubled or missing.

The numbers that are read change as CCSDS 502.0-B says, or the message is refused, or something is said; a field
is never dropped in silence. Messages go in either notation through the reader of trainings, the check, the start
of a prediction and that of an assimilation.
"""

from __future__ import annotations

import copy
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from .doors import FIXES, MODEL, answered, assimilating, enter, fixes
from .readings import READERS, Change, held, nothing

RADIUS, SPEED, TILT = 7000.0, 7.546053290107541, 0.9
NAMES = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
LEAP = 1.0
"""Seconds that 2016-12-31 was longer than other days, in UTC alone."""
ILLEGAL = ["abc", "1,5", "0x10", "1_000.0", "nan", "inf", "-Infinity", "1e999", "--1", "1.0.0"]


def message() -> dict:
    """Return the parts of a sound message: an orbit over the end of 2016, a state each minute."""
    states = []
    for k in range(12):
        angle = SPEED / RADIUS * (60.0 * k + (LEAP if k > 5 else 0))
        flat = [np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]
        turned = [(a, b * np.cos(TILT), b * np.sin(TILT)) for a, b in flat]
        minute = f"2016-12-31T23:{54 + k}:30" if k < 6 else f"2017-01-01T00:{k - 6:02}:30"
        numbers = [
            f"{size * c:.12f}" for size, part in zip((RADIUS, SPEED), turned, strict=True) for c in part
        ]
        states.append([minute, *numbers])
    meta = {"OBJECT_NAME": "MINE", "OBJECT_ID": "2016-001A", "CENTER_NAME": "EARTH", "REF_FRAME": "EME2000"}
    meta |= {"TIME_SYSTEM": "UTC", "START_TIME": states[0][0], "STOP_TIME": states[-1][0]}
    head = [("CREATION_DATE", "2017-01-02T00:00:00"), ("ORIGINATOR", "TEST")]
    return {
        "version": "2.0",
        "head": head,
        "meta": [*meta.items()],
        "states": states,
        "covariances": [],
        "units": {},
    }


def field(name: str, value: str | None) -> object:
    """Return a change of metadata; None leaves the field out."""

    def change(m: dict) -> None:
        kept = [(key, value if key == name else old) for key, old in m["meta"]]
        kept = kept if name in dict(m["meta"]) else [*m["meta"], (name, value)]
        m["meta"] = [(key, text) for key, text in kept if text is not None]

    return change


def twice(name: str, value: str) -> object:
    """Return a change that says a field a second time."""
    return lambda m: m["meta"].append((name, value))


def cell(row: int, column: int, text: str) -> object:
    """Return a change of a cell of the states."""

    def change(m: dict) -> None:
        m["states"][row][column] = text

    return change


def without_leap(times: np.ndarray, states: np.ndarray) -> tuple:
    """Return what other clocks than UTC make of the epochs."""
    return np.where(times > 350, times - LEAP, times), states


def number(row: int, column: int, value: float) -> object:
    """Return what becomes of a cell with another number, in km or km/s."""

    def expected(times: np.ndarray, states: np.ndarray) -> tuple:
        states[row, column - 1] = 1000 * value
        return times, states

    return expected


def covariance(diagonal: str = "1.0", epoch: str = "", frame: str | None = None, cells: int = 21) -> object:
    """Return a change that adds a covariance, of the last state where no epoch is given."""

    def change(m: dict) -> None:
        numbers = [diagonal if i == j else "0.0" for i in range(6) for j in range(i + 1)]
        m["covariances"].append((epoch or m["states"][-1][0], frame, numbers[:cells]))

    return change


def changes() -> list[Change]:
    """Return all changes."""
    made: list[Change] = [
        ("nothing", nothing, "same"),
        ("version 9.9", lambda m: m.update(version="9.9"), "word"),
        ("version x", lambda m: m.update(version="x"), "word"),
        ("version 1.0", lambda m: m.update(version="1.0"), "same"),
        ("another originator", lambda m: m["head"].append(("MESSAGE_ID", "1")), "same"),
        ("accelerations", lambda m: [row.extend(["1e-3", "0", "0"]) for row in m["states"]], "word"),
        ("eight columns", lambda m: m["states"][3].append("1.0"), "refused"),
        ("six columns", lambda m: m["states"][3].pop(), "refused"),
        ("a state twice", lambda m: m["states"].insert(4, m["states"][3]), "refused"),
        ("states in reverse", lambda m: m["states"].reverse(), "refused"),
        ("no state", lambda m: m["states"].clear(), "refused"),
        ("a covariance", covariance(), "word"),
        ("a covariance of 20 numbers", covariance(cells=20), "refused"),
        ("a covariance of text", covariance("x"), "refused"),
        ("an epoch of the frame", field("REF_FRAME_EPOCH", "1950-01-01T00:00:00"), "word"),
        ("an unknown field", field("FOO", "1"), "word"),
        ("a start of another day", field("START_TIME", "2017-02-01T00:00:00"), "word"),
        ("a stop before the last state", field("STOP_TIME", "2016-12-31T23:56:00"), "word"),
        ("a start that is none", field("START_TIME", "yesterday"), "word"),
        ("a useable start", field("USEABLE_START_TIME", "2016-12-31T23:58:00"), "word"),
        ("a useable stop", field("USEABLE_STOP_TIME", "2017-01-01T00:02:00"), "word"),
        ("a useable start that is none", field("USEABLE_START_TIME", "x"), "word"),
        ("a Z", cell(0, 0, "2016-12-31T23:54:30Z"), "same"),
        ("a day of the year", cell(0, 0, "2016-366T23:54:30.000"), "same"),
        ("a 13th month", cell(0, 0, "2016-13-31T23:54:30"), "refused"),
        ("an offset", cell(0, 0, "2016-12-31T22:54:30-01:00"), "same"),
        ("no epoch", cell(3, 0, "nan"), "refused"),
        ("an epoch twice", cell(3, 0, "2016-12-31T23:56:30"), "refused"),
        ("an exponent", cell(0, 1, "7.000000000000E+03"), number(0, 1, 7000.0)),
        ("an exponent without a point", cell(0, 1, "7E3"), number(0, 1, 7000.0)),
        ("a plus", cell(0, 1, "+7000"), number(0, 1, 7000.0)),
    ]
    made += [(f"{name} empty", field(name, ""), "refused") for name in REQUIRED]
    made += [(f"{name} missing", field(name, None), "refused") for name in REQUIRED]
    made += [(f"{name} twice", twice(name, value), "word") for name, value in TWICE.items()]
    made += [(f"{name} twice, alike", twice(name, dict(message()["meta"])[name]), "same") for name in TWICE]
    made += [
        (f"frame {name}", field("REF_FRAME", name), "word")
        for name in ("ITRF2014", "TEME", "TOD", "nan", "1")
    ]
    made += [(f"centre {name}", field("CENTER_NAME", name), "word") for name in ("MARS", "MOON", "SUN", "7")]
    made += [
        (f"clock {name}", field("TIME_SYSTEM", name), without_leap) for name in ("TAI", "TT", "GPS", "TDB")
    ]
    made += [(f"clock {name}", field("TIME_SYSTEM", name), "word") for name in ("FOO", "MET", "nan")]
    made += [
        ("clock utc", field("TIME_SYSTEM", "utc"), "same"),
        ("centre Earth", field("CENTER_NAME", "Earth"), "same"),
    ]
    made += [(f"{NAMES[c - 1]} {text}", cell(5, c, text), "refused") for c in (1, 4, 6) for text in ILLEGAL]
    return made


REQUIRED = ("OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM")
TWICE = {"REF_FRAME": "ITRF2014", "CENTER_NAME": "MARS", "TIME_SYSTEM": "TAI", "OBJECT_ID": "2017-002B"}
STARTS = [change for change in changes() if "covariance" not in change[0]] + [
    ("a covariance of another epoch", covariance(epoch="2016-12-31T23:54:30"), "word"),
    ("a covariance in RTN", covariance(frame="RTN"), "word"),
    ("a negative covariance", covariance("-1.0"), "refused"),
    ("an infinite covariance", covariance("inf"), "refused"),
    (
        "an hour later",
        lambda m: [row.__setitem__(0, row[0].replace("T23:", "T22:")) for row in m["states"]],
        "word",
    ),
]


def kvn(m: dict) -> str:
    """Return the message as keyword = value."""
    lines = [f"CCSDS_OEM_VERS = {m['version']}", *(f"{k} = {v}" for k, v in m["head"]), "", "META_START"]
    lines += [*(f"{k} = {v}" for k, v in m["meta"]), "META_STOP", *(" ".join(row) for row in m["states"])]
    if m["covariances"]:
        lines.append("COVARIANCE_START")
        for epoch, frame, cells in m["covariances"]:
            lines += [f"EPOCH = {epoch}", *([f"COV_REF_FRAME = {frame}"] if frame else [])]
            lines += [" ".join(cells[i * (i + 1) // 2 : (i + 1) * (i + 2) // 2]) for i in range(6)]
        lines.append("COVARIANCE_STOP")
    return "\n".join(lines) + "\n"


def xml(m: dict) -> str:
    """Return the message as XML."""
    names = ["EPOCH", *NAMES, "X_DDOT", "Y_DDOT", "Z_DDOT"]
    tags = ["C" + a + "_" + b for i, a in enumerate(NAMES) for b in NAMES[: i + 1]]
    out = [
        f'<oem id="CCSDS_OEM_VERS" version="{m["version"]}"><header>',
        grouped(m["head"]),
        "</header><body><segment>",
    ]
    out += ["<metadata>", grouped(m["meta"]), "</metadata><data>"]
    for row in m["states"]:
        out += ["<stateVector>", grouped(zip(names, row, strict=False)), "</stateVector>"]
    for epoch, frame, cells in m["covariances"]:
        pairs = [
            ("EPOCH", epoch),
            *([("COV_REF_FRAME", frame)] if frame else []),
            *zip(tags, cells, strict=False),
        ]
        out += ["<covarianceMatrix>", grouped(pairs), "</covarianceMatrix>"]
    return "\n".join([*out, "</data></segment></body></oem>"]) + "\n"


def grouped(pairs) -> str:
    """Return elements."""
    return "".join(f"<{key}>{value}</{key}>" for key, value in pairs)


NOTATIONS = {".oem": kvn, ".xml": xml}
LOOSE = {"eight columns"}
"""Changes of which XML, where numbers have names, knows nothing."""


def cases(draw, folder):
    """Yield a change, a notation and a door."""
    known = changes()
    while True:
        suffix, place = draw.choice(list(NOTATIONS)), Path(tempfile.mkdtemp(dir=folder))
        door = draw.choice([*READERS, *READERS, *READERS, *COMMANDS])
        name, change, expected = draw.choice(known if door in READERS else STARTS)
        if suffix == ".xml" and name in LOOSE:
            continue
        attempt = partial(read, READERS.get(door)) if door in READERS else partial(begun, COMMANDS[door])
        yield f"{suffix} {name}, {door}", partial(attempt, place, suffix, change, expected)


def pair(place: Path, suffix: str, change) -> tuple[Path, Path]:
    """Write the sound message and the changed one."""
    sound = message()
    changed = copy.deepcopy(sound)
    change(changed)
    paths = []
    for name, m in (("a", sound), ("b", changed)):
        (place / name).mkdir()
        paths.append(place / name / f"mine{suffix}")
        paths[-1].write_text(NOTATIONS[suffix](m))
    return paths[0], paths[1]


def read(reader, place, suffix, change, expected) -> None:
    """Read both messages."""
    one, other = pair(place, suffix, change)
    held(expected, reader(one), reader(other))


def predicting(path: Path, output: Path) -> list[str]:
    """Return the words of a prediction from the first state."""
    return ["predict", MODEL, f"start={path}", "duration=5min", f"output={output}"]


def following(path: Path, output: Path) -> list[str]:
    """Return the words of an assimilation from the last state."""
    angle = SPEED / RADIUS * (60.0 * 11 + LEAP)
    rows = [(700.0 + t[0], RADIUS * np.cos(angle), *t[2:]) for t in FIXES]
    words = assimilating(fixes(output.with_suffix(".fixes"), rows), f"start={path}", f"output={output}")
    words = [word for word in words if not word.startswith("epoch=")]
    return ["assimilate", *words, "epoch=2016-12-31T23:54:30", "start_sd=[1,0.001]"]


COMMANDS = {"predict": predicting, "assimilate": following}


def begun(words, place, suffix, change, expected) -> None:
    """Begin at both; what goes out differs, or something is said, unless the numbers are the same."""
    found = []
    for name, path in zip("ab", pair(place, suffix, change), strict=True):
        output = place / f"{name}{'.oem' if words is predicting else '.csv'}"
        code, said = enter(place, *words(path, output))
        if name == "b":
            answered(code, said)
        assert code == 0, f"a sound start is refused: {said[-300:]}"
        text = "\n".join(line for line in output.read_text().splitlines() if "CREATION_DATE" not in line)
        found.append((text, said.replace(str(path), "").replace(str(output), "")))
    (one, said), (other, then) = found
    if expected == "refused":
        raise AssertionError(f"accepted{' unchanged' * (one == other)}: {then[-200:]}")
    if expected == "word":
        assert one != other or said != then, "dropped without a word"
    elif expected == "same":
        assert one == other, "other numbers"
