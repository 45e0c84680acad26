"""Units and frames that are wrong, judged by the motion itself; and the command that says so."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from entry import SMALL, call

from ahnn.data import Files
from ahnn.data.doctor import examine, orbits
from ahnn.data.doctor.slopes import slopes, weights
from ahnn.data.files.frames import TURN
from ahnn.data.files.reading import FileReading
from ahnn.errors import UserError

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def bench():
    """The generator of the benchmark, so that both draw alike."""
    spec = importlib.util.spec_from_file_location("bench_doctor", ROOT / "benchmarks" / "bench_doctor.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("kind", ["spring", "pendulum", "LEO", "GEO", "Molniya"])
@pytest.mark.sampled(2)
def test_every_mistake_is_seen_and_sound_data_pass(bench, kind, tmp_path):
    for k, (name, mistake) in enumerate(bench.MISTAKES.get(kind, bench.ORBITS).items()):
        draw = np.random.default_rng(k)
        table = bench.noisy(bench.DRAWN[kind](draw), draw)
        assert bench.verdict(table, tmp_path) == []
        assert bench.verdict(mistake(table, draw), tmp_path), name


def test_what_is_wrong_is_named(bench, tmp_path):
    draw = np.random.default_rng(0)
    leo = bench.DRAWN["LEO"](draw)
    for mistake, expected in {
        "m as km": "positions are 1000 times too large (m as km?)",
        "min as s": "times are 60 times too small (min as s?)",
        "min and km/min as s": "times are 60 times too small (min as s?)",
        "m and m/s as km": "positions are 1000 times too large (m as km?)",
        "Earth-fixed as inertial": "positions rotate with the Earth",
        "inertial as Earth-fixed": "positions are in an inertial frame",
    }.items():
        found = bench.verdict(bench.ORBITS[mistake](leo, draw), tmp_path)
        assert [one.what for one in found if one.column == "x"] == [
            f"not an orbit around the Earth: {expected}"
        ]
        assert {one.level for one in found} == {"fault"}
    found = bench.verdict(bench.ORBITS["m/s as km/s"](leo, draw), tmp_path)
    assert {one.what for one in found} == {f"v{x} is 1000 times the change in {x} per s" for x in "xyz"}
    assert "Correct the unit: metres given as km" in found[0].remedy
    heavy = leo._replace(v=2.5 * leo.v)
    assert "is 2.5 times the change" in bench.verdict(heavy, tmp_path)[0].what
    assert "If it is a momentum" in bench.verdict(heavy, tmp_path)[0].remedy


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_of_polynomials_are_exact_at_any_times(order):
    times = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 40))
    polynomial = np.polynomial.Polynomial([1.0, -0.3, 0.02, 1e-3, -2e-5])
    found = slopes(times, polynomial(times)[:, None], order)
    expected = polynomial.deriv(order)(times[found.at])
    assert np.abs(found.values[:, 0] - expected).max() < 1e-10 * np.abs(expected).max()
    assert np.allclose(weights(np.array([[-2.0, -1, 0, 1, 2]]), 1) * 12, [[1, -8, 0, 8, -1]], atol=1e-12)


def test_an_orbit_of_another_body_and_no_orbit_pass():
    t = np.linspace(0, 5000, 60)
    for name, mu in orbits.MU.items():
        rate = 2e-3 / 3  # about half a revolution
        q = (mu / rate**2) ** (1 / 3) * np.stack((np.cos(rate * t), np.sin(rate * t), 0 * t), axis=1)
        assert orbits.misfit(t, q, [mu], turned=False) < 1e-3
        assert orbits.hypothesis(t, q, name, turning=False) == ""
        assert orbits.hypothesis(t, q, None, turning=False) == ""
        assert "m as km" in orbits.hypothesis(t, 1000 * q, name, turning=False)
    spring = np.stack([np.cos(1e-3 * t + phase) for phase in (0, 1, 2)], axis=1)
    assert orbits.hypothesis(t, spring, None, turning=False) == ""
    still = np.tile([(orbits.MU["EARTH"] / TURN**2) ** (1 / 3), 0.0, 0.0], (60, 1))
    assert "rotate with the Earth" in orbits.hypothesis(17 * t, still, "EARTH", turning=False)


def angles(tmp_path, values, name="a.csv"):
    path = tmp_path / name
    rows = [f"{0.1 * k:.1f},{value!r}" for k, value in enumerate(values.tolist())]
    path.write_text("\n".join(["t [s],q [rad]", *rows]) + "\n")
    return [(one.level, one.row, one.column, one.what) for one in of_columns([path], FileReading())]


def of_columns(*given, **options):
    """What is found in columns, and not that one trajectory makes no splits."""
    return [one for one in examine(*given, **options).findings if one.column]


def test_angles_may_jump_by_a_turn_and_not_swing_too_far(tmp_path):
    turning = 0.5 * np.arange(30.0)
    assert angles(tmp_path, turning) == []
    wrapped = (turning + np.pi) % (2 * np.pi) - np.pi
    said = "an angle that jumps by a full turn, 2 times: read as continuous"
    assert angles(tmp_path, wrapped) == [("note", 1, "q", said)]
    swing = np.cos(0.3 * np.arange(60.0))
    assert angles(tmp_path, 3 * swing) == []
    assert [one[:3] for one in angles(tmp_path, 30 * swing)] == [("warning", 1, "q")]


def test_canonical_momenta_that_are_no_mass_times_velocity_are_only_warned_of(tmp_path):
    t = 0.05 * np.arange(50)
    rows = zip(t.tolist(), np.cos(t).tolist(), (-3 * np.sin(t)).tolist(), strict=True)
    (tmp_path / "a.csv").write_text("t,q,p\n" + "\n".join(",".join(map(repr, row)) for row in rows) + "\n")
    path = [tmp_path / "a.csv"]
    assert of_columns(path, FileReading(), mass=3.0) == []
    (found,) = of_columns(path, FileReading(), mass=1.0)
    assert (found.level, found.what) == ("warning", "p over the mass is 3 times the change in q per 1")
    (found,) = of_columns(path, FileReading())
    assert (found.level, found.what) == ("fault", "momenta without a stated mass")


@pytest.fixture
def mislabelled(tmp_path):
    """Springs whose velocities are in cm/s given as m/s."""
    lines = (ROOT / "tests" / "fixtures" / "swings.csv").read_text().splitlines()
    head, rows = lines[0], [line.split(",") for line in lines[1:]]
    spoiled = [",".join((*row[:-1], repr(100 * float(row[-1])))) for row in rows]
    path = tmp_path / "swings.csv"
    path.write_text("\n".join((head, *spoiled)) + "\n")
    return path


def test_the_command_shows_draws_and_ends_with_2(mislabelled, tmp_path, capsys):
    assert call("ahnn.data.__main__", "check", str(mislabelled), f"figures={tmp_path}/seen") == 2
    shown = capsys.readouterr()
    assert max(map(len, shown.out.splitlines())) <= 80
    assert "fault   swings.csv" in shown.out
    assert "1 file, 120 samples: 1 fault, 0 warnings, 0 notes" in shown.out
    assert shown.err == "ahnn: check: expected valid data; received 1 fault that would spoil the training\n"
    drawn = {path.name for path in (tmp_path / "seen").iterdir()}
    assert drawn == {"swings.csv.png", "swings.csv.svg", ".ahnn-files"}
    assert call("ahnn.data.__main__", "check", str(ROOT / "tests" / "fixtures" / "swings.csv")) == 0
    columns = "swings.csv: id id; time t [s]; position q [m]; velocity v [m/s]\n"
    assert capsys.readouterr().out == f"{columns}1 file, 120 samples: 0 faults, 0 warnings, 0 notes\n"


def test_the_document_shows_what_the_command_prints(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert call("ahnn.data.__main__", "check", "tests/fixtures/spoiled.csv") == 2
    shown = capsys.readouterr()
    lines = [line.rstrip() for line in (shown.out + shown.err).splitlines()]
    assert "\n".join(lines) in (ROOT / "docs" / "data.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "usage: python -m ahnn.data check PATH... "),
        (["look", "a.csv"], "received: look a.csv"),
        (["check", "none.csv"], "expected a file; received none.csv: No such file"),
        (["check", "a.csv", "figure=x"], "check: unknown key 'figure'; did you mean 'figures'?"),
        (
            ["check", "a.csv", "mass=-1"],
            "mass: expected a list of float > 0 or canonical or float > 0 or None; received -1",
        ),
        (["check", "a.csv", "frame=ITRF"], "frame: expected one of GCRF, EME2000 or None; received 'ITRF'"),
    ],
)
def test_a_mistake_in_the_command_is_one_message(arguments, expected, capsys):
    assert call("ahnn.data.__main__", *arguments) == 2
    assert expected in capsys.readouterr().err


def test_a_training_asks_first(mislabelled, tmp_path, capsys):
    small = [word for word in SMALL if not word.startswith(("system.", "data.trajectories"))]
    command = ["system=files", f"system.path={mislabelled}", f"run={tmp_path}/run", "window=1", *small]
    assert call("ahnn.train", *command) == 2
    said = capsys.readouterr().err
    assert (
        "swings.csv, row 1, column v: expected valid data; received: v is 100 times the change in q per s"
        in said
    )
    assert "`python -m ahnn.data check` lists all faults. Set system.unsound=true to train anyway" in said
    assert not (tmp_path / "run").exists()
    Files("springs", str(mislabelled), unsound=True).check()
    with pytest.raises(UserError, match="expected valid data"):
        Files("springs", str(mislabelled)).check()
