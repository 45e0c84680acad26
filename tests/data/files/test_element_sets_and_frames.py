"""Element sets through SGP4, and frames: against published states, other theories and formulas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from entry import SMALL, call
from hypothesis import given, settings
from hypothesis import strategies as st
from made_files import ORBIT, csv_of, orbit

from ahnn.data import Files
from ahnn.data.doctor import examine
from ahnn.data.files import Ephemeris, frames, instant, write_oem
from ahnn.data.files.reading import FileReading
from ahnn.errors import UserError
from ahnn.evaluation import load_results
from ahnn.jobs.checking import check
from ahnn.loading import load

FIXED = "CIRS of 1980-01-01T00:00:00.000"
VANGUARD = """VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
"""The first set of the verification of SGP4 (AIAA 2006-6753)."""


def test_element_sets_are_propagated_to_the_published_states(tmp_path):
    pytest.importorskip("sgp4")
    (tmp_path / "a.tle").write_text(VANGUARD)
    files = Files("orbit", str(tmp_path / "a.tle"), step=21600.0, duration=86400.0)
    states, times, *_ = files.read()
    assert times.tolist() == [[0.0, 21600.0, 43200.0, 64800.0, 86400.0]]
    assert files.space.frame == "TEME, EARTH, UTC, from 2000-06-27T18:50:19.733568"
    published = [7022.46529266, -1400.08296755, 0.03995155, 1.893841015, 6.405893759, 4.534807250]
    assert states[0, 0].tolist() == pytest.approx(published, abs=2e-8)
    published = [-7154.03120202, -3783.17682504, -3536.19412294, 4.741887409, -4.151817765, -2.093935425]
    assert states[0, 1].tolist() == pytest.approx(published, abs=2e-8)  # after 360 minutes


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("4753", "4754", "row 2, column checksum: expected 3; received '4'. The line is damaged"),
        (" 10.82419157413667", "", "row 3: expected 69 signs; received 51"),
        ("2 00005", "2 00006", "row 3, column checksum: expected 8"),
        (
            "\n2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667",
            "",
            "row 2: expected a line 2",
        ),
    ],
)
def test_a_damaged_element_set_is_named(tmp_path, old, new, expected):
    assert old in VANGUARD
    (tmp_path / "a.txt").write_text(VANGUARD.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        Files("orbit", str(tmp_path / "a.txt"), step=60.0, duration=600.0)
    assert expected in str(caught.value)


def test_element_sets_need_a_step_and_a_duration(tmp_path):
    (tmp_path / "a.tle").write_text(VANGUARD)
    with pytest.raises(UserError, match=r"expected the sampling interval.* Set step=SECONDS and duration="):
        Files("orbit", str(tmp_path / "a.tle"), step=60.0)


def test_faults_of_element_sets_leave_the_others(tmp_path):
    pytest.importorskip("sgp4")
    other = VANGUARD.replace("4753", "4759", 1)
    path = tmp_path / "a.txt"
    path.write_text(f"{VANGUARD}{other}2 00005 alone\n{VANGUARD}")
    found = examine([path], FileReading(step=60.0, duration=600.0))
    assert [(one.row, one.column) for one in found.faults[:3]] == [(5, "checksum"), (7, ""), (7, "")]
    assert [track.rows[0] for track in found.contents[0].tracks] == [2, 9]
    assert found.faults[-1].row == 9  # the same set twice: its samples leak


def test_frames_that_clash_are_refused_unless_they_are_turned(tmp_path):
    pytest.importorskip("sgp4")
    (tmp_path / "a.tle").write_text(VANGUARD)
    start, (t, states) = instant("2000-06-27T18:00:00", utc=True), orbit()
    write_oem(tmp_path / "b.oem", [Ephemeris("1", "S", "EARTH", "EME2000", "UTC", start, t, states)])
    paths, sets = [str(tmp_path / "a.tle"), str(tmp_path / "b.oem")], {"step": 60.0, "duration": 600.0}
    with pytest.raises(UserError, match=r"b.oem: expected frame TEME, EARTH.*received EME2000, EARTH"):
        Files("both", paths, **sets)
    both = Files("both", paths, frame="EME2000", **sets)
    assert both.space.frame.startswith("EME2000, EARTH, UTC, from 2000-06-27T18:00:00")
    assert both.recipe() != Files("both", paths, frame="GCRF", **sets).recipe()


@settings(max_examples=25, deadline=None)
@given(st.integers(-(10**9), 10**9), st.sampled_from(["TEME", "ITRF", "EME2000", FIXED]))
def test_turns_are_rotations_and_go_together(seconds, frame):
    pytest.importorskip("erfa")
    tt = frames.terrestrial(seconds * 10**12, np.array([0.0, 5000.0]), "UTC")
    one, other = (frames.rotations(tt, frame, into) for into in frames.INERTIAL)
    assert np.abs(one @ one.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert np.abs(frames.rotations(tt, "GCRF", "EME2000") @ one - other).max() < 1e-12
    if frame == FIXED:
        assert np.array_equal(one[0], one[1])
        assert not np.allclose(one, frames.rotations(tt, "CIRS", "GCRF"), rtol=0, atol=1e-9)


def test_the_frame_is_kept_in_the_results_of_a_training(tmp_path):
    pytest.importorskip("erfa")
    (tmp_path / "a.tle").write_text(VANGUARD)
    files = [f"system.path={tmp_path}/a.tle", "system.step=60", "system.duration=20000", "system.cut=30"]
    small = [word for word in SMALL if not word.startswith(("system.", "data.trajectories", "trainer.max"))]
    run = tmp_path / "run"
    command = ["system=files", *files, "system.frame=GCRF", f"run={run}", "window=1", "trainer.max_epochs=1"]
    assert call("ahnn.train", *command, *small) == 0
    assert load_results(run).space.frame == "GCRF, EARTH, UTC, from 2000-06-27T18:50:19.733568"
    assert load(run).space.frame == load_results(run).space.frame


def test_teme_agrees_with_the_theory_of_1980(tmp_path):
    """Its precession, nutation and equinoxes share nothing with 2006/2000A; 0.1'' is 3.4 m."""
    erfa = pytest.importorskip("erfa")
    (tmp_path / "a.tle").write_text(VANGUARD)
    given = Files("orbit", str(tmp_path / "a.tle"), step=1.0, duration=20.0)
    got = Files("orbit", str(tmp_path / "a.tle"), step=1.0, duration=20.0, frame="EME2000")
    assert got.space.frame.startswith("EME2000, EARTH, UTC, from 2000-06-27")
    tt = (2451544.5, 178 + (18 * 3600 + 50 * 60 + 19.733568 + 64.184) / 86400)
    matrix = erfa.pnm80(*tt).T @ erfa.rz(-erfa.eqeq94(*tt), np.eye(3))
    before, after = (files.read().states[0, 0].reshape(2, 3).numpy() for files in (given, got))
    difference = np.linalg.norm(after - before @ matrix.T, axis=1)
    assert difference[0] < 0.004
    assert difference[1] < 4e-6
    assert np.linalg.norm(after - before, axis=1)[0] > 0.5


def require_derivatives(states, step):
    """Velocities are central differences of fourth order of the positions, but for the precession."""
    q, v = (x.numpy() for x in states.chunk(2, dim=-1))
    slope = (8 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12 * step)
    assert np.abs(slope - v[2:-2]).max() < 1e-7 * np.abs(v).max()


def test_a_point_of_the_earth_moves_with_it_and_itrf_is_what_erfa_says(tmp_path):
    erfa = pytest.importorskip("erfa")
    place = np.array([4000.0, 3000.0, 4000.0, 0.0, 0.0, 0.0])
    start = instant("2024-03-01T12:00:00", utc=True)
    states, times = np.tile(place, (21, 1)), np.arange(21.0)
    write_oem(tmp_path / "a.oem", [Ephemeris("1", "S", "EARTH", "ITRF2014", "UTC", start, times, states)])
    got = Files("ground", str(tmp_path / "a.oem"), frame="GCRF").read().states[0]
    require_derivatives(got, 1.0)
    utc = (2460370.5, 0.5)
    tt = erfa.taitt(*erfa.utctai(*utc))
    assert np.abs(got[0, :3].numpy() - erfa.c2t06a(*tt, *utc, 0.0, 0.0).T @ place[:3]).max() < 1e-6
    for clock, reading in {
        "TAI": "12:00:37",
        "GPS": "12:00:18",
        "TT": "12:01:09.184",
        "TDB": "12:01:09.184",
    }.items():
        start = instant(f"2024-03-01T{reading}", utc=False)
        write_oem(tmp_path / "b.oem", [Ephemeris("1", "S", "EARTH", "ITRF", clock, start, times, states)])
        same = Files("ground", str(tmp_path / "b.oem"), frame="GCRF").read().states[0]
        assert float((same - got).abs().max()) < 1e-6


def test_gcrf_and_eme2000_differ_by_the_bias_of_the_frames(tmp_path):
    t, states = orbit()
    start = instant("2024-03-01T12:00:00", utc=True)
    write_oem(tmp_path / "a.oem", [Ephemeris("1", "S", "EARTH", "EME2000", "UTC", start, t, states)])
    got = Files("o", str(tmp_path / "a.oem"), frame="GCRF").read().states[0].numpy()
    arcsec = np.pi / 648000
    size = np.linalg.norm(got[:, :3] - states[:, :3], axis=1) / 7000.0 / arcsec
    assert 0.005 < size.max() < 0.03  # offsets of 6.8, 16.6 and 14.6 thousandths of a second of arc
    assert Files("o", str(tmp_path / "a.oem"), frame="EME2000").read().states[0, 3, 0] == states[3, 0]


def test_what_is_left_out_costs_what_the_document_says():
    erfa, arcsec = pytest.importorskip("erfa"), np.pi / 648000
    exact, document = (
        erfa.c2t06a(2460370.5, 0.3, 2460370.5, 0.3, 0, 0),
        Path(__file__).parents[3] / "docs" / "frames.md",
    )
    for words, (ut1, x, y) in {
        "UT1 - UTC of 0.1 s": (0.1, 0.0, 0.0),
        "UT1 - UTC of 0.9 s, the maximum": (0.9, 0.0, 0.0),
        "polar motion of 0.3 and 0.5 arcseconds": (0.0, 0.3, 0.5),
    }.items():
        other = erfa.c2t06a(2460370.5, 0.3, 2460370.5, 0.3 + ut1 / 86400, x * arcsec, y * arcsec)
        largest = np.linalg.norm(other - exact, ord=2)  # over all directions
        costs = [f"{1e3 * largest * radius:,.0f} m" for radius in (6900.0, 42164.0)]
        assert f"| {words} | {' | '.join(costs)} |" in document.read_text()


@pytest.mark.parametrize(
    ("header", "sidecar", "expected"),
    [
        (["t [UTC]", *ORBIT], None, "expected a frame that can be converted to GCRF: .* none. Set it"),
        (["t [UTC]", *ORBIT], "frame: MOD", "ITRF; received MOD$"),
        (["t [s]", *ORBIT], "frame: TEME", "column t: expected epochs such as .* received numbers"),
        (["t [UTC]", "a [m]", "b [m]", "va [m/s]", "vb [m/s]"], "frame: TEME", "expected three coordinates"),
    ],
)  # fmt: skip
def test_a_frame_that_cannot_be_turned_is_refused(tmp_path, header, sidecar, expected):
    texts = ["2024-01-01T00:00:00", "2024-01-01T00:01:00"] if "UTC" in header[0] else [0, 60]
    (tmp_path / "a.csv").write_text(
        csv_of(header, [(text, 7000, 0, 0, 0, 7.5, 0)[: len(header)] for text in texts])
    )
    if sidecar:
        (tmp_path / "a.yaml").write_text(sidecar)
    with pytest.raises(UserError, match=expected):
        Files("mine", str(tmp_path / "a.csv"), frame="GCRF")


def test_the_data_check_propagates_element_sets_for_a_day(tmp_path, capsys):
    pytest.importorskip("sgp4")
    (tmp_path / "a.tle").write_text(VANGUARD)
    check([tmp_path / "a.tle"], None, {})
    of_a_day = capsys.readouterr().out
    assert "1,441" in of_a_day
    check([tmp_path / "a.tle"], None, {"step": 60.0, "duration": 86400.0})
    assert capsys.readouterr().out == of_a_day
    check([tmp_path / "a.tle"], None, {"duration": 600.0})
    assert capsys.readouterr().out != of_a_day
