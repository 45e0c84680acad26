"""Streams of dated measurements: stations on the turning Earth, times as dates, and streams that fail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from entry import call
from test_assimilate import ORBIT
from test_assimilate_starts import (
    DATED,
    FROM_NOON,
    MODEL,
    NOON,
    NUMBERS,
    PLAIN,
    START,
    assimilate,
    dated,
    good,
    place,
    rows,
)

from ahnn.data.reference import Reference
from ahnn.measurements import GroundStation
from ahnn.tracking.earth_axes import earth_axes

__all__ = ["place"]  # the fixture of every test


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
    assert "measurement.model.earth_angle turns the Earth about the z axis of EME2000" in caplog.text
    assert "expected a filter that follows them; received 6 rejected of 10 lines" in capsys.readouterr().err
    text = ["time,range,azimuth,elevation", *lines[:3], lines[3].rpartition(",")[0] + ",40.0", *lines[4:]]
    Path("seen.csv").write_text("\n".join(text) + "\n")  # of which one line is wrong
    command[-1] = "output=bad.csv"
    assert call("ahnn.assimilate", *command) == 0
    assert "line 5: elevation: expected at most pi/2 rad; received 40. If the values are" in caplog.text
    Path("seen.csv").write_text("\n".join([text[0], text[4]]) + "\n")
    command[-1] = "output=degrees.csv"
    assert call("ahnn.assimilate", *command) == 2
    assert (
        "received 40. If the values are in degrees, name the column elevation [deg]"
        in capsys.readouterr().err
    )
    assert not Path("degrees.csv").exists()


def test_rows_in_no_order_are_named(capsys):
    head, *lines = Path("fixes.csv").read_text().splitlines()
    Path("fixes.csv").write_text("\n".join([head, lines[8], lines[9], *lines[:8]]) + "\n")
    assert assimilate(*NUMBERS, PLAIN) == 3
    said = (
        "received 8 late of 10 lines. Check the units, the order of columns and rows, the stations and the "
    )
    said += "start, and sort"
    assert said in capsys.readouterr().err


def test_the_time_of_a_start_is_a_number_or_a_date(caplog):
    numbers = [f"start={ORBIT[20].tolist()}", "start_sd=[0.1,1e-4]", FROM_NOON]
    assert assimilate(*numbers, DATED, f"time={dated(300)}") == 0
    assert good(rows())
    assert "Set time=" not in caplog.text
    Path("out.csv").unlink()
    lines = Path("fixes.csv").read_text().replace("\n3", "\n900003").replace("\n4", "\n900004")
    Path("far.csv").write_text(lines)
    assimilate(*numbers, "measurements=far.csv", "gap=1e7")
    assert caplog.text.count("start: no time is stated; 0 is assumed, but the first measurement is at 9") == 1


def test_a_dated_stream_resumes_and_names_epochs(caplog):
    whole = Path("dated.csv").read_text().splitlines(keepends=True)
    Path("dated.csv").write_text("".join(whole[:6]))
    assert assimilate(START, DATED, "state=a.state") == 0
    Path("dated.csv").write_text("".join([*whole, whole[1]]))
    assert assimilate(START, DATED, "state=a.state") == 0
    assert [row["epoch"][14:19] for row in rows()] == [
        f"{s // 60:02}:{s % 60:02}" for s in range(315, 465, 15)
    ]
    Path("dated.csv").write_text("".join([*whole, *8 * [whole[1]]]))
    caplog.clear()
    assert assimilate(START, DATED, "state=a.state") == 0
    assert caplog.text.count("arrived too late") == 5
    assert "; further ones are counted" in caplog.text
    Path("dated.csv").write_text("".join([*whole, whole[1]]))
    Path("a.state").unlink()
    Path("out.csv").unlink()
    assert assimilate(START, DATED, "state=a.state") == 0
    late = "line 12: 2024-03-01T12:05:15 (time 15 s) arrived too late, after 2024-03-01T12:07:30 ("
    assert late.replace(" arrived", " from sensor position arrived") in caplog.text or late in caplog.text
