"""Reports of damaged run folders: a report, or one message that says what is wrong, never a traceback."""

from __future__ import annotations

import copy
import json
import math
import random

import pytest
from entry import call
from runs import FLOORS, results, scores, write

from ahnn.evaluation import Row, Who

HOSTILE = [
    None,
    True,
    0,
    -1,
    1e308,
    math.nan,
    math.inf,
    10**30,
    "",
    "x",
    "<b>",
    "\x1b[2J",
    [],
    [[]],
    {},
    {"a": 1},
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    rows = [
        Row(who, scores(size))
        for start in ("true", "perturbed")
        for who, size in (
            (Who("model", start), 1.0),
            (Who("model", start, "ukf"), 0.5),
            (Who("exact flow", start, floor=True), FLOORS[start]),
        )
    ]
    return write(tmp_path_factory.mktemp("damaged") / "run", results(rows))


def places(value, path=()):
    """Every place in nested plain values."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*path, key)
        yield from places(item, (*path, key))


def damaged(whole, draw):
    """The values with one of them replaced, missing or doubled."""
    found = copy.deepcopy(whole)
    *way, last = draw.choice([*places(found)])
    inner = found
    for key in way:
        inner = inner[key]
    kind = draw.choice(["other", "other", "other", "missing", "doubled"])
    if kind == "missing":
        del inner[last]
    elif kind == "doubled" and isinstance(inner, list):
        inner.append(inner[last])
    else:
        inner[last] = draw.choice(HOSTILE)
    return found


def answered(run, capfd, *more):
    code = call("ahnn.report", str(run), "report.figures=false", *more)
    err = capfd.readouterr().err
    assert "Traceback" not in err
    if code:
        assert code == 2
        assert err.startswith("ahnn: ")
        assert err.count("\n") == 1
        assert err.strip().isprintable()
    return code


def test_results_with_one_thing_wrong_are_reported_or_refused_in_one_message(run, tmp_path, capfd):
    draw, whole, codes = random.Random(46), json.loads((run / "metrics.json").read_text()), []
    for k in range(40):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / "metrics.json").write_text(json.dumps(damaged(whole, draw)))
        codes.append(answered(folder, capfd))
    assert {*codes} == {0, 2}


def test_results_with_bytes_wrong_are_too(run, tmp_path, capfd):
    draw, whole = random.Random(47), (run / "metrics.json").read_bytes()
    for k in range(12):
        folder, content = tmp_path / str(k), bytearray(whole)
        folder.mkdir()
        for _ in range(draw.randint(1, 3)):
            content[draw.randrange(len(content))] = draw.randrange(256)
        (folder / "metrics.json").write_bytes(
            content[: draw.choice([len(content), draw.randrange(len(content))])]
        )
        answered(folder, capfd)
