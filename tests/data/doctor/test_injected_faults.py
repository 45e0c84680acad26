"""A hundred faults put into sound tables: each is found with its file, row and column, in one pass."""

from __future__ import annotations

import random

import numpy as np
import pytest

from ahnn.data.doctor import examine
from ahnn.data.files import Ephemeris, instant, write_oem
from ahnn.data.files.reading import FileReading

HEADER = ["id", "t [s]", "x [m]", "y [m]", "vx [m/s]", "vy [m/s]"]
NAMES = [name.split()[0] for name in HEADER]
SAMPLES = 60


def swings():
    """Two trajectories of two oscillators, as cells."""
    t = 0.05 * np.arange(SAMPLES)
    rows = []
    for name, phase in (("a", 0.3), ("b", 1.1)):
        q = np.stack((np.cos(2 * t + phase), 0.7 * np.sin(3 * t + phase)))
        v = np.stack((-2 * np.sin(2 * t + phase), 2.1 * np.cos(3 * t + phase)))
        rows += [[name, f"{s:.2f}", *map("{:.15g}".format, x)] for s, *x in zip(t, *q, *v, strict=True)]
    return rows


def text(rows, header=HEADER):
    return "\n".join(",".join(row) for row in (header, *rows)) + "\n"


def inject(kind, rows, draw):
    """Spoil a place of the rows; return the row in the file and the column where it should be found."""
    k, c = draw.randrange(3, SAMPLES - 3) + draw.choice((0, SAMPLES)), draw.randrange(2, 6)
    if kind in ("text", "inf", "nan", "empty"):
        rows[k][c] = {"text": "1.2.3", "inf": "-inf", "nan": "NaN", "empty": ""}[kind]
        return k + 2, NAMES[c]
    if kind in ("short", "long"):
        rows[k] = rows[k][:-1] if kind == "short" else [*rows[k], "0"]
        return k + 2, ""
    if kind in ("no time", "twice", "back"):
        rows[k][1] = {"no time": "", "twice": rows[k - 1][1], "back": "-1.0"}[kind]
        return k + 2, "t"
    if kind == "gap":
        del rows[k : k + 2]
        return k + 2, "t"
    if kind == "constant":
        for row in rows:
            row[c] = "0.25"
        return 1, NAMES[c]
    assert kind == "factor"
    for row in rows:
        row[c] = repr(draw.choice((1000, 0.001)) * float(row[c])) if row[0] == "b" else row[c]
    return 1, NAMES[4 + c % 2]


KINDS = ("text", "inf", "nan", "empty", "short", "long", "no time", "twice", "back", "gap", "constant")


@pytest.mark.parametrize("kind", KINDS)
def test_each_of_ten_injected_faults_is_found_where_it_is(kind, tmp_path):
    for case in range(10):
        draw, rows = random.Random(f"{kind} {case}"), swings()
        row, column = inject(kind, rows, draw)
        path = tmp_path / f"{case}.csv"
        path.write_text(text(rows))
        found = examine([path], FileReading()).findings
        assert (str(path), row, column) in {(one.file, one.row, one.column) for one in found}, found
        warned = kind in ("nan", "empty", "gap") or (kind == "constant" and column in NAMES[4:])
        levels = {one.level for one in found if (one.row, one.column) == (row, column)}
        assert ("warning" if warned else "fault") in levels


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b""),
        ("a.csv", bytes(range(256))),
        ("a.parquet", bytes(range(256))),
        ("a.csv", b"t,x\n"),
        ("a.csv", b"t,x\n,1\n"),
        ("a.oem", b"CCSDS_OEM_VERS = 2.0\n"),
        ("a.xml", b"<oem>"),
        ("a.csv", b"id,t,x\n" + b"a,0,1\n" * 3),
    ],
)
def test_what_is_no_data_at_all_is_a_fault(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert examine([tmp_path / name], FileReading()).faults


def test_single_samples_are_a_fault_and_a_single_trajectory_is_warned_of(tmp_path):
    for samples, trajectories, expected in ((1, 3, ["fault"]), (2, 1, ["warning"]), (2, 2, [])):
        rows = "".join(f"{b},{k},{b + k}\n" for b in range(trajectories) for k in range(samples))
        (tmp_path / "a.csv").write_text(f"id,t,x\n{rows}")
        assert [one.level for one in examine([tmp_path / "a.csv"], FileReading()).findings] == expected


def test_sound_files_have_no_findings(tmp_path):
    (tmp_path / "a.csv").write_text(text(swings()))
    assert examine([tmp_path / "a.csv"], FileReading()).findings == []


def test_all_faults_of_several_files_are_found_in_one_pass(tmp_path):
    draw, paths, expected = random.Random(0), [], set()
    for name in ("one", "other"):
        rows, path = swings(), tmp_path / f"{name}.csv"
        for k, kind in enumerate(("text", "inf", "nan", "empty")):
            at = 5 + 10 * k + draw.randrange(5)
            rows[at][2 + k] = {"text": "?", "inf": "inf", "nan": "nan", "empty": ""}[kind]
            expected.add((str(path), at + 2, NAMES[2 + k]))
        rows[70].pop()
        expected.add((str(path), 72, ""))
        for row in rows:  # the second file is other data than the first
            row[2:4] = [
                repr(1.5 * float(x)) if name == "other" and x not in ("?", "inf", "") else x for x in row[2:4]
            ]
            row[4:] = [
                repr(1.5 * float(x)) if name == "other" and x not in ("?", "inf", "") else x for x in row[4:]
            ]
        path.write_text(text(rows))
        paths.append(path)
    (tmp_path / "broken.csv").write_text("t [s],x [miles]\n0,1\n")
    found = examine([*paths, tmp_path / "broken.csv"], FileReading()).findings
    places = {(one.file, one.row, one.column) for one in found}
    assert expected | {(str(tmp_path / "broken.csv"), 1, "x")} <= places
    assert {place for place in places if place[2] != "t"} == expected | {
        (str(tmp_path / "broken.csv"), 1, "x")
    }


def test_a_single_trajectory_in_other_units_is_named_by_its_first_row(tmp_path):
    rows = swings()
    for row in rows[SAMPLES:]:
        row[3] = repr(1000 * float(row[3]))
    (tmp_path / "a.csv").write_text(text(rows))
    (found,) = examine([tmp_path / "a.csv"], FileReading()).findings
    assert (found.level, found.row, found.column) == ("fault", SAMPLES + 2, "vy")
    assert "0.001 times the change in y per s" in found.what


def test_all_faults_of_a_message_are_found_in_one_pass(tmp_path):
    path, start = tmp_path / "a.oem", instant("2017-01-01T01:00:00", utc=True)
    states = np.outer(np.arange(9.0) ** 2, np.arange(1.0, 7.0))
    write_oem(path, [Ephemeris("1", "S", "EARTH", "EME2000", "UTC", start, np.arange(9.0), states)])
    lines = path.read_text().splitlines()
    states = [k for k, line in enumerate(lines) if line.startswith("2017-01-01T01")][2:8:2]
    lines[states[0]] += " 1.0"
    lines[states[1]] = lines[states[1]].replace("01-01", "01-32")
    cells = lines[states[2]].split()
    lines[states[2]] = " ".join((*cells[:5], "fast", *cells[6:]))
    path.write_text("\n".join(lines) + "\n")
    found = [(one.row, one.column) for one in examine([path], FileReading()).faults]
    assert found == [(states[0] + 1, ""), (states[1] + 1, "EPOCH"), (states[2] + 1, "Y_DOT")]


@pytest.mark.parametrize(("shift", "count"), [(0, 20), (7, 20), (11, 8)])
def test_samples_in_two_trajectories_leak(tmp_path, shift, count):
    (tmp_path / "a.csv").write_text(text(swings()))
    copied = [["c", f"{0.05 * k:.2f}", *row[2:]] for k, row in enumerate(swings()[shift : shift + count])]
    (tmp_path / "b.csv").write_text(text(copied))
    found = [
        one
        for one in examine([tmp_path / "a.csv", tmp_path / "b.csv"], FileReading()).findings
        if "samples" in one.what
    ]
    assert [(one.level, one.file, one.row) for one in found] == [("fault", str(tmp_path / "b.csv"), 2)]
    assert f"row {shift + 2} of {tmp_path / 'a.csv'} of trajectory a" in found[0].what


def test_rest_and_single_equal_samples_are_no_leak(tmp_path):
    rows = swings()
    for k in (0, 9, 10):
        rows[SAMPLES + k][2:] = rows[k][2:]
    rest = [[name, f"{0.05 * k:.2f}", "0", "0", "0", "0"] for name in "cd" for k in range(20)]
    (tmp_path / "a.csv").write_text(text(rows + rest))
    assert not [one for one in examine([tmp_path / "a.csv"], FileReading()).findings if "samples" in one.what]


def test_noise_is_estimated(tmp_path):
    draw, rows = np.random.default_rng(0), swings()
    for row in rows:
        row[2] = repr(float(row[2]) + 0.01 * draw.standard_normal())
    (tmp_path / "a.csv").write_text(text(rows))
    (found,) = examine([tmp_path / "a.csv"], FileReading()).findings
    assert (found.level, found.column) == ("note", "x")
    assert float(found.what.split()[3]) == pytest.approx(0.01, rel=0.4)
    assert found.what.endswith(" m")
