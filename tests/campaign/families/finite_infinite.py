"""Numbers that are not finite, huge, tiny or negative zero, in every numeric place of every door.

What is accepted gives finite numbers, and an ephemeris message that can be read again; -0.0 counts as 0.0; no
line of a stream is fatal, and lines around a hostile one keep their rows.
"""

from __future__ import annotations

import csv
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
import yaml

import ahnn
from ahnn.data.doctor import examine
from ahnn.data.files import Files, read_oem
from ahnn.data.files.reading import FileReading
from ahnn.data.files.table import is_number
from ahnn.systems.gravity.gfc import read_gfc
from ahnn.types import Space, Units

from .doors import FIXES, MODEL, START, answered, assimilating, enter, fixes, numbers, spelled

VALUES = [math.nan, math.inf, -math.inf, 1e155, -1e155, 1e200, 1e308, 1e-320, -0.0, 1e-200, 2.0**63]
PREDICT = ("start", "start_sd", "duration", "step", "time", "mean", "sd", "covariance", "file")
KEYS = ("start", "start_sd", "time", "window", "lines", "gap", "every", "measurement.sd", "plugins.ukf.gate",
        "plugins.ukf.process_noise", "plugins.ukf.alpha", "plugins.ukf.beta", "plugins.ukf.kappa",
        "plugins.ukf.patience", "plugins.ukf.novelty", "mean", "sd", "covariance")  # fmt: skip
CALLS = ("rollout start", "rollout dt", "predict start", "predict times", "predict start_sd", "novelty", "energy",
         "flow", "flow dt", "space", "trajectories")  # fmt: skip
PASSED_ON = {"rollout start", "rollout dt", "novelty", "energy", "flow", "flow dt"}
"""Calls that are plain arithmetic: what is not finite, or too large, may come out as it went in."""
GRAVITY = """product_type gravity_field
modelname MINE
earth_gravity_constant 3.986004415e14
radius 6378136.3
max_degree 2
errors no
norm fully_normalized
tide_system zero_tide
end_of_head
gfc 0 0 1.0 0.0
gfc 1 0 0.0 0.0
gfc 1 1 0.0 0.0
gfc 2 0 -4.84169e-04 0.0
gfc 2 1 -2.4e-10 1.4e-09
gfc 2 2 2.43938e-06 -1.40027e-06
"""


def cases(draw, folder):
    """Yield a door, one of its numbers and a value for it."""
    while True:
        kind = draw.choice(
            ["predict", "stream", "stream", "keys", "call", "call", "call", "gravity", "table", "table"]
        )
        value, place = draw.choice(VALUES), Path(tempfile.mkdtemp(dir=folder))
        if kind == "predict":
            name, k, suffix = (
                draw.choice(PREDICT),
                draw.randrange(6),
                draw.choice([".csv", ".oem", ".xml", ".parquet"]),
            )
            yield f"predict {name} {k} {value} {suffix}", partial(predicted, place, name, k, value, suffix)
        elif kind == "stream":
            name, line = (
                draw.choice(["time", "x", "sd_y", "json time", "json x", "json sd_y"]),
                draw.randint(0, 5),
            )
            yield f"line {line} {name} {value}", partial(streamed, place, name, line, value)
        elif kind == "keys":
            name, k = draw.choice(KEYS), draw.randrange(6)
            yield f"assimilate {name} {k} {value}", partial(keyed, place, name, k, value)
        elif kind == "call":
            name, k = draw.choice(CALLS), draw.randrange(6)
            yield f"Python {name} {k} {value}", partial(called, name, k, value)
        elif kind == "gravity":
            row, column = draw.choice([2, 3, 4, *range(9, 15)]), draw.randint(1, 4)
            yield f"gravity row {row} column {column} {value}", partial(gravity, place, row, column, value)
        else:
            name, row = draw.choice(["t", "q", "v"]), draw.randrange(12)
            yield f"table {name} {row} {value}", partial(tabled, place, name, row, value)


def with_one(values: list[float], k: int, value: float) -> list[float]:
    """Return numbers of which one is another."""
    return [value if i == k % len(values) else each for i, each in enumerate(values)]


def predicted(place: Path, name: str, k: int, value: float, suffix: str) -> None:
    """Predict from it."""
    words = {
        "start": numbers(START),
        "duration": "10min",
        "epoch": "2024-03-01T12:00:00",
        "frame": "[GCRF,EARTH,UTC]",
    }
    if name in ("duration", "step"):
        words[name] = spelled(value)
    elif name == "start_sd":
        words[name] = numbers(with_one([1.0, 1e-3], k, value))
    elif name == "file":
        head = "t [s],x [km],y [km],z [km],vx [km/s],vy [km/s],vz [km/s]"
        rows = [(60.0 * i, *START) for i in range(3)]
        words["start"] = str(
            fixes(place / "start.csv", [with_one([*rows[0]], k + 1, value), *rows[1:]], head)
        )
    else:
        words["start"] = numbers(with_one(START, k, value))
    done = enter(
        place,
        "predict",
        MODEL,
        *(f"{key}={word}" for key, word in words.items()),
        f"output={place}/o{suffix}",
    )
    finite(place / f"o{suffix}", *done)
    if value == 0 and name == "start" and suffix == ".csv":
        words["start"] = numbers(with_one(START, k, 0.0))
        answered(
            *enter(
                place, "predict", MODEL, *(f"{key}={w}" for key, w in words.items()), f"output={place}/p.csv"
            )
        )
        assert numbers_of(place / "o.csv") == numbers_of(place / "p.csv"), "-0.0 is another number than 0.0"


def finite(path: Path, code: int, said: str) -> None:
    """Assert a clear end, and finite numbers in what was written."""
    answered(code, said)
    assert path.exists(), f"exit code 0 and no output: {said[-200:]}"
    if path.suffix in (".oem", ".xml"):
        assert all(math.isfinite(x) for one in read_oem(path) for row in one.states for x in row)
    elif path.suffix == ".csv":
        assert all(map(math.isfinite, numbers_of(path))), f"what is not finite went out: {said[-200:]}"
    else:
        assert bool(Files("again", str(path)).read().states.isfinite().all()), "what is not finite went out"


def numbers_of(path: Path, left_out: tuple[str, ...] = ()) -> list[float]:
    """Return the numbers in a table that we wrote; an empty cell is NaN."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    cells = [cell for row in rows for name, cell in row.items() if not name.startswith(left_out or ("?",))]
    return [float(cell or "nan") for cell in cells if not cell or is_number(cell)]


def streamed(place: Path, name: str, line: int, value: float) -> None:
    """Take a stream of which one number is hostile: nothing ends, and all other lines have their rows."""
    json, column = name.startswith("json"), name.rpartition(" ")[2]
    rows = [{"time": t, "x": x, "y": y, "z": z, "sd_y": 0.2} for t, x, y, z in FIXES]
    rows = [{**row, "time": row["time"] + shift} for shift in (0.0, 1.0) for row in rows]
    rows = sorted(rows, key=lambda row: row["time"])
    rows[line][column] = value
    path = place / "fixes.csv"
    if json:
        lines = [str(row).replace("'", '"').replace("nan", "NaN").replace("inf", "Infinity") for row in rows]
        path.write_text("\n".join(lines) + "\n")
    else:
        fixes(path, [tuple(row.values()) for row in rows], "time [s],x [km],y [km],z [km],sd_y [km]")
    code, said = enter(place, "assimilate", *assimilating(path, f"output={place}/o.csv"))
    assert code == 0, f"exit code {code}: a line is fatal: {said[-300:]}"
    answered(code, said)
    with (place / "o.csv").open() as file:
        taken = {row["line"]: row for row in csv.DictReader(file)}
    own = str(line + 1 + (not json))
    missing = [str(k + 1 + (not json)) for k in range(6) if str(k + 1 + (not json)) not in (own, *taken)]
    assert not missing, f"lines {missing} have no row: {said[-300:]}"
    assert own in taken or f"line {own}:" in said, f"line {own} has neither row nor word: {said[-300:]}"
    for number, row in taken.items():
        for key, cell in row.items():
            if key in ("x", "y", "z", "px", "py", "pz") or key.startswith("cov_"):
                assert cell, f"line {number}, {key}: nothing"
                assert math.isfinite(float(cell)), f"line {number}, {key}: {cell}"


def keyed(place: Path, name: str, k: int, value: float) -> None:
    """Give a key of an assimilation the value."""
    path = fixes(place / "fixes.csv")
    if name in ("mean", "sd", "covariance"):
        content = {"mean": START, "sd": [1.0, 1e-3]}
        if name == "covariance":
            content = {"mean": START, "covariance": [[float(i == j) for j in range(6)] for i in range(6)]}
            content["covariance"][k][k] = value
        else:
            content[name] = with_one(content[name], k, value)
        (place / "start.yaml").write_text(yaml.safe_dump(content))
        word = f"start={place}/start.yaml"
    elif name in ("start", "start_sd", "plugins.ukf.process_noise"):
        known = {"start": START, "start_sd": [1.0, 1e-3], "plugins.ukf.process_noise": [1e-3, 1e-5]}
        word = f"{name}={numbers(with_one(known[name], k, value))}"
    else:
        word = f"{name}={spelled(value)}"
    code, said = enter(place, "assimilate", *assimilating(path, f"output={place}/o.csv", word))
    answered(code, said)
    left_out = ("nis", "innovation", "sd_") if name in ("mean", "sd", "start", "start_sd") else ("line",)
    assert all(map(math.isfinite, numbers_of(place / "o.csv", left_out))), (
        f"exit code 0 with NaN: {said[-300:]}"
    )


def called(name: str, k: int, value: float) -> None:
    """Call something in Python with it."""
    run, state = ahnn.load("molniya_mechanical"), with_one(START, k, value)
    found: Callable[[], object] = {
        "rollout start": lambda: run.rollout([state], 5),
        "rollout dt": lambda: run.rollout([START], 5, value),
        "predict start": lambda: run.predict([state], [0.0, 60.0, 120.0]).states,
        "predict times": lambda: run.predict([START], with_one([0.0, 60.0, 120.0], k, value)).states,
        "predict start_sd": lambda: (
            run.predict([START], [0.0, 60.0], start_sd=with_one([1.0] * 6, k, value)).covariances
        ),
        "novelty": lambda: run.novelty([state]),
        "energy": lambda: run.energy([state]),
        "flow": lambda: run.flow([state]),
        "flow dt": lambda: run.flow([START], value),
        "space": lambda: spaced(value),
        "trajectories": lambda: trained_on(k, value),
    }[name]
    result = found()
    if not isinstance(result, torch.Tensor):
        return
    whole = bool(result.isfinite().all())
    if name in PASSED_ON and not abs(value) < 1e100:
        unseen = name == "novelty"  # networks of a mechanical model see no momenta
        assert unseen or not whole or math.isfinite(value), f"{value} became finite: {result}"
    else:
        assert whole, f"what is not finite: {result}"


def spaced(value: float) -> None:
    """Use a space of that mass; raises what a training would."""
    states = torch.randn(4, 9, 2, dtype=torch.float64)
    times = 0.1 * torch.arange(9, dtype=torch.float64)
    space = Space("mine", ("q", "p"), Units(), value)
    from ahnn.data import Given

    Given(ahnn.Trajectories(states, times), space)
    assert math.isfinite(value) and value > 0, f"a mass of {value} is accepted"  # noqa: PT018


def trained_on(k: int, value: float) -> torch.Tensor:
    """Bring the value as a sample into statistics."""
    from ahnn.data import Given
    from ahnn.statistics import Statistics

    states = torch.randn(4, 9, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(k))
    states[k % 4, 3 + k % 3, k % 2] = value
    data = Given(
        ahnn.Trajectories(states, 0.1 * torch.arange(9, dtype=torch.float64)), Space("mine", ("q", "p"))
    )
    found = Statistics.of(data.read())
    return torch.cat([found.increment, found.rate, found.maximum, found.minimum])


def gravity(place: Path, row: int, column: int, value: float) -> None:
    """Read a gravity field with it."""
    lines = [line.split() for line in GRAVITY.splitlines()]
    lines[row][min(column, len(lines[row]) - 1)] = repr(value)
    (place / "mine.gfc").write_text("\n".join(map(" ".join, lines)) + "\n")
    field = read_gfc(place / "mine.gfc")
    q = torch.tensor([[7000.0, 100.0, 200.0]], dtype=torch.float64)
    for found in (field.attraction(q), field.potential(q)):
        assert bool(found.isfinite().all()), f"the field is {found.tolist()}"
    size = float(field.attraction(q).norm())
    assert 1e-4 < size < 1e-1 or row in (2, 3) and value > 0, f"an attraction of {size:.3g} km/s^2 in orbit"  # noqa: RUF021


def tabled(place: Path, name: str, row: int, value: float) -> None:
    """Read and examine a table with it."""
    rows = [[k * 0.1, math.cos(k * 0.1), -math.sin(k * 0.1)] for k in range(12)]
    rows[row][("t", "q", "v").index(name)] = value
    path = fixes(place / "mine.csv", rows, "t [s],q [m],v [m/s]")
    examine([path], FileReading(), None, 10.0)
    files = Files("mine", str(path))
    files.check()
    found = [
        x for x in files.read().states.flatten().tolist() + files.read().times.flatten().tolist() if x == x
    ]
    assert all(map(math.isfinite, found)), "what is not finite is accepted"
    assert math.isnan(value) or value in found, f"{value} is not among the numbers that were read"
