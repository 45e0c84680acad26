"""Exact motion at any rate of samples, single samples that are wrong, and what is too little to learn."""

from __future__ import annotations

import numpy as np
import pytest
from entry import call

from ahnn.data.doctor import examine
from ahnn.data.files.reading import FileReading

MU = 398600.4418


def ellipse(per_period, count=60, eccentricity=0.0, axis=7000.0):
    """An exact orbit, so many samples in a period: times in s, states in km and km/s."""
    rate = np.sqrt(MU / axis**3)
    t = 2 * np.pi / rate / per_period * np.arange(count)
    mean = rate * t + 0.3
    e, anomaly = eccentricity, mean.copy()
    for _ in range(100):
        anomaly -= (anomaly - e * np.sin(anomaly) - mean) / (1 - e * np.cos(anomaly))
    c, s, root = np.cos(anomaly), np.sin(anomaly), np.sqrt(1 - e**2)
    q = axis * np.stack((c - e, 0.8 * root * s, 0.6 * root * s), axis=1)
    v = axis * rate * np.stack((-s, 0.8 * root * c, 0.6 * root * c), axis=1) / (1 - e * c)[:, None]
    return t, np.concatenate((q, v), axis=1)


def checked(folder, t, states):
    rows = "".join(
        ",".join(map(repr, (time, *state))) + "\n"
        for time, state in zip(t.tolist(), states.tolist(), strict=True)
    )
    (folder / "a.csv").write_text(f"t [s],x [km],y [km],z [km],vx [km/s],vy [km/s],vz [km/s]\n{rows}")
    return [one for one in examine([folder / "a.csv"], FileReading()).findings if one.column]


@pytest.mark.parametrize("per_period", [1.53, 2.2, 2.7, 3.1, 4.0, 10.0, 40.0])
@pytest.mark.parametrize("count", [25, 200])
def test_an_exact_orbit_has_no_noise_however_rare_its_samples(tmp_path, per_period, count):
    found = checked(tmp_path, *ellipse(per_period, count))
    assert [one.what for one in found if "noise of" in one.what or one.level != "note"] == []
    assert bool([one for one in found if "too sparse" in one.what]) or per_period != 2.2


@pytest.mark.parametrize("eccentricity", [0.3, 0.6, 0.74])
def test_dense_eccentric_orbits_have_no_findings(tmp_path, eccentricity):
    assert checked(tmp_path, *ellipse(120, 240, eccentricity, 26000.0)) == []


def test_the_noise_of_a_dense_orbit_is_still_found(tmp_path):
    t, states = ellipse(100, 300)
    states[:, 0] += 0.5 * np.random.default_rng(0).standard_normal(300)
    (found,) = [one for one in checked(tmp_path, t, states) if "noise" in one.what]
    assert (found.column, found.level) == ("x", "note")
    assert float(found.what.split()[3]) == pytest.approx(0.5, rel=0.2)


@pytest.mark.parametrize("off", [1.0, -3.0, 500.0])
@pytest.mark.parametrize("row", [5, 50, 94])
def test_an_outlier_of_a_kilometre_is_named_and_nothing_beside_it(tmp_path, off, row):
    t, states = ellipse(90, 100)
    states[row, 1] += off
    found = [one for one in checked(tmp_path, t, states) if "outlier" in one.what]
    assert all(" km from the curve" in one.what for one in found)
    assert [(one.row, one.column) for one in found] == [(row + 2, "y")]
    assert "loss.robust=student" in found[0].remedy


def test_outliers_beside_missing_samples_are_found_too(tmp_path):
    """Polynomials through uneven samples swing: neighbours are off by different amounts, or by more."""
    draw = np.random.default_rng(1)
    at = np.flatnonzero(draw.random(3000) > 0.06)
    rows = np.arange(100, 2700, 100)
    x = np.sin(at / 300) + 0.005 * draw.standard_normal(len(at))
    x[rows] += 0.8
    lines = "".join(f"{k * 0.01!r},{value!r}\n" for k, value in zip(at.tolist(), x.tolist(), strict=True))
    (tmp_path / "a.csv").write_text(f"t,x\n{lines}")
    found = examine([tmp_path / "a.csv"], FileReading()).findings
    assert [one.row for one in found if "outlier" in one.what] == (rows + 2).tolist()


def test_most_outliers_of_twenty_standard_deviations_are_found(tmp_path):
    t, states = ellipse(90, 2000)
    draw, rows = np.random.default_rng(2), np.arange(50, 1950, 97)
    states += draw.standard_normal(states.shape) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
    states[rows, 0] += 20 * draw.choice([-1.0, 1.0], len(rows))
    found = [one for one in checked(tmp_path, t, states) if "outlier" in one.what]
    assert {(one.row, one.column) for one in found} <= {(row + 2, "x") for row in rows.tolist()}
    assert len(found) > 0.75 * len(rows)


def test_maneuvers_and_jumps_are_no_outliers(tmp_path):
    t, states = ellipse(90, 100)
    _, other = ellipse(90, 100, 0.1)
    kink = states[50] + (t[50:, None] - t[50]) * np.array([0.05, 0, 0, 0, 0, 0])
    for spoiled in (
        np.concatenate((states[:50], other[50:])),
        np.concatenate((states[:50], states[50:] + kink - states[50])),
    ):
        assert not [one for one in checked(tmp_path, t, spoiled) if "outlier" in one.what]


def test_noise_has_no_outliers(tmp_path):
    t, states = ellipse(90, 400)
    states += np.random.default_rng(1).standard_normal(states.shape) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
    assert not [one for one in checked(tmp_path, t, states) if "outlier" in one.what]


def test_a_small_component_of_a_velocity_is_judged_by_the_whole(tmp_path):
    """Nearly in the equator: what a theory leaves in vz is large beside vz and small beside the speed."""
    t, states = ellipse(90, 100)
    flat = states * [1, 1.25, 1e-6, 1, 1.25, 1e-6]
    flat[:, 5] += 1e-4
    assert [one for one in checked(tmp_path, t, flat) if one.level == "fault"] == []
    flat[:, 5] += 0.5
    assert [one.column for one in checked(tmp_path, t, flat) if one.level == "fault"] == ["vz"]


def test_a_position_that_never_changes_is_a_fault_before_a_training(tmp_path):
    rows = "".join(f"{b},{0.1 * k},{float(np.cos(k + b))!r},5.0\n" for b in range(3) for k in range(30))
    (tmp_path / "a.csv").write_text(f"id,t,x,y\n{rows}")
    found = [
        (one.level, one.column, one.what) for one in examine([tmp_path / "a.csv"], FileReading()).findings
    ]
    assert ("fault", "y", "always 5") in found


def test_a_path_may_have_an_equals_sign_and_a_wrong_key_is_still_one(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{b},{k},{b + k * k}\n" for b in range(3) for k in range(5))
    for name in ("08_run=3.csv", "gap=3.csv"):
        (tmp_path / name).write_text(f"ID,T,X\n{rows}")
    assert (
        call("ahnn.data.__main__", "check", "08_run=3.csv", "./gap=3.csv", "gap=20") == 2
    )  # the same samples
    shown = capsys.readouterr()
    assert "id ID; time T; position X" in shown.out
    assert "2 files, 30 samples" in shown.out
    assert call("ahnn.data.__main__", "check", "08_run=3.csv", "09_run=3.csv") == 2
    assert "unknown key '09_run'" in capsys.readouterr().err


@pytest.mark.parametrize("time", ["1e200", "9.3e18"])
def test_a_time_beyond_all_others_is_a_fault_and_no_traceback(tmp_path, time):
    path = tmp_path / "a.csv"
    times = [*map(str, range(20)), time]
    path.write_text("t [s],x [m],vx [m/s]\n" + "".join(f"{t},{k % 3},{k % 5}\n" for k, t in enumerate(times)))
    faults = examine([path], FileReading(), 1.0).faults
    assert any("missing samples" in fault.what or "a finite number up to" in fault.what for fault in faults)
