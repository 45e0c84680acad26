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
from ahnn.data.reference import Reference
from ahnn.measurements import GroundStation
from ahnn.tracking.earth_axes import earth_axes

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


def test_the_time_of_a_start_is_a_number_or_a_date(caplog):
    numbers = [f"start={ORBIT[20].tolist()}", "start_sd=[0.1,1e-4]", FROM_NOON]
    assert assimilate(*numbers, DATED, f"time={dated(300)}") == 0
    assert good(rows())
    assert "Set time=" not in caplog.text
    Path("out.csv").unlink()
    lines = Path("fixes.csv").read_text().replace("\n3", "\n900003").replace("\n4", "\n900004")
    Path("far.csv").write_text(lines)
    assimilate(*numbers, "measurements=far.csv", "gap=1e7")
    assert caplog.text.count("start: its time is taken as 0, and the first measurement is at 9") == 1


MISTAKES = {
    "a date of a start, and no epoch": ([*NUMBERS, PLAIN, f"time={dated(3)}"], "time: expected epoch= of"),
    "no date": ([*NUMBERS, PLAIN, "time=noon"], "epoch= of time zero beside a date; received noon"),
    "numbers, and nobody says from when": ([START, PLAIN], "expected epochs, since the start has an epoch"),
    "two times": ([START, PLAIN, FROM_NOON, "time=3"], "time: expected none, since the start file"),
    "dates, and no epoch": (
        [*NUMBERS, DATED],
        "epoch: expected the epoch of time zero, since the measurements have",
    ),
    "oem of nobody knows when": (
        [*NUMBERS, PLAIN, "oem=o.oem"],
        "oem: expected frame=, center=, time_system",
    ),
    "oem of nobody knows where": (
        [*NUMBERS, PLAIN, "oem=o.oem", FROM_NOON],
        "oem: expected frame=, center= of",
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
        ("EME2000", "MARS", "expected centre EARTH, that of the model; received MARS"),
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
    assert "its covariance is that of a state 300 s earlier" in caplog.text
    write_start(known=100.0)  # of no state
    assert assimilate(START, DATED, "output=b.csv") == 2
    assert assimilate(START, DATED, "output=b.csv", "start_sd=[0.1,1e-4]") == 0


def test_the_output_of_a_filter_is_a_start_of_all_commands():
    assert assimilate(START, DATED) == 0
    last, said = rows()[-1], Path("out.yaml").read_text()
    assert last["epoch"] == "2024-03-01T12:07:30.000"
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


def test_a_dated_stream_resumes_and_names_epochs(caplog):
    whole = Path("dated.csv").read_text().splitlines(keepends=True)
    Path("dated.csv").write_text("".join(whole[:6]))
    assert assimilate(START, DATED, "state=a.state") == 0
    Path("dated.csv").write_text("".join([*whole, whole[1]]))
    assert assimilate(START, DATED, "state=a.state") == 0
    assert [row["epoch"][14:19] for row in rows()] == [
        f"{s // 60:02}:{s % 60:02}" for s in range(315, 465, 15)
    ]
    late = (
        "line 12: 2024-03-01T12:05:15 (time 15 s) is later than the window allows, at 2024-03-01T12:07:30 ("
    )
    assert late.replace(" is", " of sensor position is") in caplog.text or late in caplog.text


def test_a_start_of_positions_says_how_one_comes_by_a_state(capsys):
    assert assimilate("start=fixes.csv", PLAIN, "start_sd=[1,1]") == 2
    assert "received x, y, z alone. The output of ahnn.assimilate" in capsys.readouterr().err


def seen_from_kiruna(erfa, state, seconds):
    """Range, azimuth and elevation of a state in EME2000, as erfa turns the Earth."""
    tt = 2460371.0, (seconds + 69.184) / 86400
    earth = np.matmul(erfa.c2t06a(*tt, 2460371.0, seconds / 86400, 0.0, 0.0), erfa.bp00(*tt)[0].T)
    place = np.radians([20.96, 67.86])
    line = earth @ state[:3] - erfa.gd2gc(1, *place, 0.0) / 1e3
    sines, cosines = np.sin(place), np.cos(place)
    east = line @ [-sines[0], cosines[0], 0.0]
    up = line @ [cosines[1] * cosines[0], cosines[1] * sines[0], sines[1]]
    north = line @ [-sines[1] * cosines[0], -sines[1] * sines[0], cosines[1]]
    return [np.linalg.norm(line), np.arctan2(east, north), np.arctan2(up, np.hypot(east, north))]


@pytest.mark.parametrize("days", [0, 1])
def test_stations_turn_as_the_earth_does(days):
    erfa = pytest.importorskip("erfa", reason="the extra `orbit` is needed")
    station = GroundStation(67.86, 20.96, earth_angle=earth_axes(Reference("J2000", "EARTH", "UTC", NOON)))
    expected = seen_from_kiruna(erfa, ORBIT[20].numpy(), 86400.0 * days)
    apart = (station(ORBIT[20], 86400.0 * days).numpy() - expected)[:3]
    assert abs(apart[0]) < 0.02
    assert np.abs(apart[1:]).max() < 0.02 / expected[0]


def test_a_stream_turns_stations_with_the_earth(caplog, capsys):
    erfa = pytest.importorskip("erfa", reason="the extra `orbit` is needed")
    seen = [seen_from_kiruna(erfa, ORBIT[20 + k].numpy(), 300.0 + 15.0 * k) for k in range(1, 11)]
    lines = [",".join([dated(315 + 15 * k), *map(str, row)]) for k, row in enumerate(seen)]
    Path("seen.csv").write_text("\n".join(["time,range,azimuth,elevation", *lines]) + "\n")
    model = {"range_rate": "false", "latitude": 67.86, "longitude": 20.96, "min_elevation": -90}
    known = ["measurement=ground_station", "measurement.sd=[0.05,1e-4,1e-4]"]
    known += [f"measurement.model.{key}={value}" for key, value in model.items()]
    noise = "{range: 0.05, azimuth: 0.0057, elevation: 0.0057}"
    Path("stations.yaml").write_text(f"kiruna: {{latitude: 67.86, longitude: 20.96, noise: {noise}}}")
    for k, way in enumerate((known, ["stations=stations.yaml"])):
        command = [*MODEL, START, "measurements=seen.csv", *way, FROM_NOON, f"output={k}.csv"]
        assert call("ahnn.assimilate", *command) == 0
        assert all(float(row["nis"]) < 10 for row in rows(f"{k}.csv"))
    command = [*MODEL, START, "measurements=seen.csv", *known, FROM_NOON, "output=out.csv"]
    assert call("ahnn.assimilate", *command, "measurement.model.earth_angle=1.0") == 3
    assert "measurement.model.earth_angle: turns the Earth about the z axis of EME2000" in caplog.text
    assert "expected a filter that follows them; received 6 rejected of 10 lines" in capsys.readouterr().err
    text = ["time,range,azimuth,elevation", *lines[:3], lines[3].rpartition(",")[0] + ",40.0", *lines[4:]]
    Path("seen.csv").write_text("\n".join(text) + "\n")  # of which one line is wrong
    command[-1] = "output=bad.csv"
    assert call("ahnn.assimilate", *command) == 0
    assert "line 5: elevation: expected at most pi/2 rad; received 40; skipped" in caplog.text
    Path("seen.csv").write_text("\n".join([text[0], text[4]]) + "\n")
    command[-1] = "output=degrees.csv"
    assert call("ahnn.assimilate", *command) == 2
    assert "received 40. Degrees? Name the column elevation [deg]" in capsys.readouterr().err
    assert not Path("degrees.csv").exists()


def test_rows_in_no_order_are_named(capsys):
    head, *lines = Path("fixes.csv").read_text().splitlines()
    Path("fixes.csv").write_text("\n".join([head, lines[8], lines[9], *lines[:8]]) + "\n")
    assert assimilate(*NUMBERS, PLAIN) == 3
    said = "received 8 late of 10 lines. Check units, order of columns and rows, stations and start, and sort"
    assert said in capsys.readouterr().err


NOTHING = {
    "late": (["time=1000"], "10 of 10 late. They precede the start: set its time="),
    "ahead": (["gap=1"], "10 of 10 ahead. They are too long after the start: set its"),
    "bad": ([], "10 of 10 bad. The lines above state"),
    "predicted": ([], "10 of 10 predicted. Their values are missing"),
    "rejected": (["plugins.ukf.gate=0.99", "plugins.ukf.patience=20"], "10 of 10 rejected. Set start="),
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
def test_a_key_that_changed_beside_a_saved_state_is_named(key, capsys):
    command = [*NUMBERS, PLAIN, "state=a.state"]
    assert assimilate(*command) == 0
    before = Path("out.csv").read_bytes()
    assert assimilate(*command, *CHANGES[key]) == 2
    assert f"{key}: expected the value stored in a.state; received another" in capsys.readouterr().err
    assert Path("out.csv").read_bytes() == before
    assert assimilate(*command) == 0
