"""`assimilate start=FILE` and streams of dates: what says when and where a start holds is used or refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from entry import call
from helpers import framed
from test_assimilate import ORBIT, RUN

from ahnn.data.estimate_table import track_names
from ahnn.data.files import Covariance, Ephemeris, Files, instant, read_oem, write_oem

NOON = instant("2024-03-01T12:00:00", utc=True)
MODEL = ["pretrained=molniya_mechanical", "plugins.ukf.process_noise=[1e-3,1e-5]"]
NUMBERS = [f"start={ORBIT[0].tolist()}", "start_sd=[0.1,1e-4]"]
P = np.diag([0.01] * 3 + [1e-8] * 3)
LEFT = {"fixes.csv", "dated.csv", "start.oem", ".ahnn-files"}  # of the fixture's start.oem


def dated(seconds):
    return f"2024-03-01T12:{seconds // 60:02}:{seconds % 60:02}"


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """A start that holds five minutes past noon, and fixes behind it: numbers from noon, and dates."""
    monkeypatch.chdir(tmp_path)
    rows = [(315 + 15 * k, *ORBIT[21 + k, :3].tolist()) for k in range(10)]
    for name, time in (("fixes.csv", str), ("dated.csv", dated)):
        lines = [",".join([time(row[0]), *map(repr, row[1:])]) for row in rows]
        Path(name).write_text("\n".join(["time,x,y,z", *lines]) + "\n")
    write_start()
    return tmp_path


def write_start(frame="EME2000", center="EARTH", known=300.0):
    states, times = ORBIT[[0, 20]].numpy(), np.array([0.0, 300.0])
    one = Ephemeris("SAT-1", "SAT-1", center, frame, "UTC", NOON, times, states, (Covariance(known, P),))
    write_oem("start.oem", [one])


def assimilate(*arguments, model=MODEL):
    return call("ahnn.assimilate", *model, "measurement.sd=0.05", "output=out.csv", *arguments)


def rows(path="out.csv"):
    return list(csv.DictReader(Path(path).read_text().splitlines()))


def good(found):
    return all(float(row["nis"]) < 30 for row in found) and len(found) == 10


START, FROM_NOON, DATED = "start=start.oem", "epoch=2024-03-01T12:00:00", "measurements=dated.csv"
PLAIN = "measurements=fixes.csv"


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        ([DATED], 15.0),  # from the start's own epoch
        ([DATED, FROM_NOON], 315.0),
        ([PLAIN, FROM_NOON], 315.0),
        ([PLAIN, "time=300"], 315.0),
    ],
    ids=str,
)
def test_a_start_holds_at_its_epoch(arguments, begins):
    assert assimilate(START, *arguments) == 0
    assert float(rows()[0]["time"]) == begins
    assert good(rows())


MISTAKES = {
    "a date of a start, and no epoch": (
        [*NUMBERS, PLAIN, f"time={dated(3)}"],
        "expected a date together with epoch=",
    ),
    "no date": (
        [*NUMBERS, PLAIN, "time=noon"],
        "a date together with epoch=, the epoch of time zero; received noon",
    ),
    "numbers, and nobody says from when": ([START, PLAIN], "expected epochs, since the start has an epoch"),
    "two times": ([START, PLAIN, FROM_NOON, "time=3"], "time: expected none, since the start file"),
    "dates, and no epoch": (
        [*NUMBERS, DATED],
        "epoch: expected the epoch of time zero, since the measurements have",
    ),
    "oem of nobody knows when": (
        [*NUMBERS, PLAIN, "oem=o.oem"],
        "oem: expected frame, centre, time system, the date",
    ),
    "oem of nobody knows where": (
        [*NUMBERS, PLAIN, "oem=o.oem", FROM_NOON],
        "T12:00:00.000'. Add, for example, frame=EME2000 center=EARTH\n",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_what_nobody_says_is_asked_for_and_leaves_nothing(name, place, capsys):
    arguments, said = MISTAKES[name]
    assert assimilate(*arguments, "state=a.state") == 2
    assert said in capsys.readouterr().err
    assert {path.name for path in place.iterdir()} == LEFT


@pytest.mark.parametrize(
    ("frame", "center", "said"),
    [
        ("ITRF2014", "EARTH", "expected an inertial frame; received ITRF2014"),
        ("EME2000", "MARS", "expected centre EARTH, as in the model; received MARS"),
    ],
)
def test_a_start_in_another_frame_or_about_another_body_is_refused(frame, center, said, capsys):
    write_start(frame, center)
    assert assimilate(START, DATED) == 2
    assert said in capsys.readouterr().err


def test_a_start_is_turned_into_the_frame_of_the_data_which_the_message_has_too():
    run = framed(Path("run"), "GCRF, EARTH, UTC, from 2024-03-01T12:00:00.000")
    write_start("ITRF2014")
    asks = Path("asks.csv")
    asks.write_text("time\n300\n")
    model = [f"run={run}", MODEL[1]]
    assert assimilate(START, "measurements=asks.csv", "oem=out.oem", model=model) == 0
    turned = Files("turned", "start.oem", frame="GCRF").read().states[0, 1]
    (row,) = rows()
    assert [float(row[name]) for name in track_names(RUN.space)] == pytest.approx(turned.tolist(), rel=1e-12)
    (orbit,) = read_oem("out.oem")
    assert (orbit.frame, orbit.center, orbit.epoch(0.0)) == ("GCRF", "EARTH", "2024-03-01T12:05:00.000")
    assert orbit.object_id == "SAT-1"
    assert assimilate(START, PLAIN, "frame=EME2000", "output=b.csv", model=model) == 2


def test_the_covariance_of_an_earlier_state_is_carried_to_the_last_one_by_the_model(caplog):
    write_start(known=0.0)
    Path("asks.csv").write_text(f"time\n{dated(300)}\n")
    assert assimilate(START, "measurements=asks.csv") == 0
    (row,) = rows()
    carried = RUN.predict(ORBIT[0], [0.0, 300.0], start_covariance=P).covariances[0, -1]
    assert float(row["x"]) == pytest.approx(float(ORBIT[20, 0]), rel=1e-14)
    assert float(row["cov_x_x"]) == pytest.approx(float(carried[0, 0]), rel=1e-9)
    assert abs(float(row["cov_x_x"]) - P[0, 0]) > 1e-3 * P[0, 0]
    assert "the covariance is propagated by the model from a state 300 s earlier" in caplog.text
    write_start(known=100.0)  # of no state
    assert assimilate(START, DATED, "output=b.csv") == 2
    assert assimilate(START, DATED, "output=b.csv", "start_sd=[0.1,1e-4]") == 0


def test_the_output_of_a_filter_is_a_start_of_all_commands():
    assert assimilate(START, DATED) == 0
    last, said = rows()[-1], Path("out.yaml").read_text()
    assert last["epoch"] == "2024-03-01T12:07:30.000"
    assert "sd_x" not in last  # that would be the standard deviation of the state
    predicted = float(last["innovation_sd_x"]) ** 2
    assert float(last["nis"]) > float(last["innovation_x"]) ** 2 / predicted * (1 - 1e-9)
    assert "x: km" in said
    assert "frame: EME2000, EARTH, UTC, from 2024-03-01T12:05:00.000" in said
    step = ["duration=1min", "output=next.csv"]
    assert call("ahnn.predict", MODEL[0], "start=out.csv", *step) == 0
    begin = rows("next.csv")[0]
    assert begin["epoch"] == "2024-03-01T12:07:30.000"
    for name, column in (("x", "x [km]"), ("vz", "vz [km/s]")):
        assert float(begin[column]) == float(last[name])
        assert float(begin[f"sd_{column}"]) ** 2 == pytest.approx(float(last[f"cov_{name}_{name}"]), rel=1e-9)
    Path("later.csv").write_text(f"time\n{dated(450)}\n")
    later = ["measurements=later.csv", "start=out.csv"]
    assert assimilate(*later, "output=again.jsonl") == 0
    again = json.loads(Path("again.jsonl").read_text())
    assert again["cov_vx_z"] == pytest.approx(float(last["cov_vx_z"]), rel=1e-9)
    assert again["time"] == 0.0 or again["time"] == float(last["time"])
    assert call("ahnn.predict", MODEL[0], "start=again.jsonl", *step) == 0
    states = Files("track", "out.csv", mass=1.0).read().states
    assert states[0, -1].tolist() == pytest.approx(
        [float(last[n]) for n in track_names(RUN.space)], rel=1e-15
    )


def test_a_start_of_positions_says_how_one_comes_by_a_state(capsys):
    assert assimilate("start=fixes.csv", PLAIN, "start_sd=[1,1]") == 2
    assert "received x, y, z only. The output of ahnn.assimilate" in capsys.readouterr().err


NOTHING = {
    "late": (["time=1000"], "10 of 10 late. They precede the start: set its time "),
    "ahead": (["gap=1"], "10 of 10 ahead. They are too long after the start: set its"),
    "bad": ([], "10 of 10 bad. The lines above state"),
    "predicted": ([], "10 of 10 predicted. Their values are missing"),
    "rejected": (["plugins.ukf.gate=0.99", "plugins.ukf.patience=20"], "10 of 10 rejected. Check the units"),
    "header": ([], "received no line after the header"),
}


@pytest.mark.parametrize("word", NOTHING)
def test_a_stream_of_which_nothing_counts_is_a_failure_with_its_cure(word, place, capsys):
    head, *lines = Path("fixes.csv").read_text().splitlines()
    times = [line.partition(",")[0] for line in lines]
    changed = {"bad": [f"{time},x,y,z" for time in times], "predicted": [f"{time},,," for time in times]}
    changed |= {"rejected": [f"{time},1e6,1e6,1e6" for time in times], "header": []}
    Path("fixes.csv").write_text("\n".join([head, *changed.get(word, lines)]) + "\n")
    arguments, said = NOTHING[word]
    assert assimilate(*NUMBERS, PLAIN, "state=a.state", *arguments) == 3
    assert said in capsys.readouterr().err
    if word not in ("predicted", "rejected"):
        assert {path.name for path in place.iterdir()} == LEFT


@pytest.mark.parametrize("key", ["seed=3", "smoother=true", "cadence=7", "start_sd=[1,1]"])
def test_keys_of_the_filter_that_a_stream_leaves_unread_are_refused(key, capsys):
    assert assimilate(*NUMBERS, PLAIN, f"plugins.ukf.{key}") == 2
    assert f"plugins.ukf.{key.partition('=')[0]}: expected a key with an effect" in capsys.readouterr().err


def test_a_stream_of_times_alone_asks_for_predictions():
    Path("asks.csv").write_text("time\n60\n")
    assert assimilate(*NUMBERS, "measurements=asks.csv") == 0
    assert float(rows()[0]["x"]) == pytest.approx(float(ORBIT[4, 0]), rel=1e-6)


CHANGES = {
    "start": [f"start={[1.0, *ORBIT[0, 1:].tolist()]}"],
    "start_sd": ["start_sd=[0.2,1e-4]"],
    "time": ["time=1"],
    "format": ["format=json"],
    "epoch, time_system": [FROM_NOON],
}


@pytest.mark.parametrize("key", CHANGES)
@pytest.mark.sampled(4)
def test_a_key_that_changed_beside_a_saved_state_is_named(key, capsys):
    command = [*NUMBERS, PLAIN, "state=a.state"]
    assert assimilate(*command) == 0
    before = Path("out.csv").read_bytes()
    assert assimilate(*command, *CHANGES[key]) == 2
    assert f"{key}: expected the value stored in a.state; received a different" in capsys.readouterr().err
    assert Path("out.csv").read_bytes() == before
    assert assimilate(*command) == 0
