"""Orbits beside tracking data: predictions (CPF) and precise ephemerides (SP3); what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from made_formats import REAL
from made_orbits import CPF, SP3

from ahnn.data.files import Files, instant
from ahnn.data.files.cpf import cpf_content, read_cpf
from ahnn.data.files.epochs import SECOND
from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.data.files.sp3 import sp3_content
from ahnn.data.files.table import Remark
from ahnn.errors import UserError


def cpf(text=CPF, note=None):
    more = {} if note is None else {"note": note}
    return cpf_content(text, "a.cpf", **more)


def sp3(text=SP3, note=None):
    more = {} if note is None else {"note": note}
    return sp3_content(text, "a.sp3", **more)


def test_a_prediction_is_an_orbit_in_kilometres_across_midnight():
    found = cpf()
    (track,) = found.tracks
    assert (found.frame, found.clock, track.name) == ("ITRF, EARTH, UTC", "UTC", "orekitSat")
    assert found.epoch == instant("2018-06-12T23:45:00", utc=True)
    assert track.times.tolist() == [0.0, 900.0, 1800.0]
    assert track.values[0].tolist() == [-3442.706377, 29234.902063, 3170.080159, -0.3005, 0.1, -2.9]
    assert found.rates == ("vx", "vy", "vz")


def test_positions_alone_and_velocities_of_some():
    plain = "".join(line for line in CPF.splitlines(keepends=True) if not line.startswith("20"))
    first = plain.replace("\n10 0 58282      0", "\n20 0 1 2 3\n10 0 58282      0")
    for text in (plain, first):
        notes = []
        found = cpf(text, notes.append)
        assert found.rates == ()
        assert found.tracks[0].values.shape == (3, 3)
        assert any("velocities not used" in one.what for one in notes) == (text is first)


def test_version_1_has_no_number_within_the_day():
    text = CPF.replace(
        "H1 CPF  2  CSG 2018  6 13 10  6641 1 orekitSat", "H1 CPF  1  SGF 2016  2 13  2  5441 lageos2"
    )
    assert cpf(text).tracks[0].name == "lageos2"


def test_the_flags_after_the_frame_may_be_missing():
    assert cpf(CPF.replace("900 1 1  0 0 0 1", "900 1 1  0 0", 1)).tracks[0].name == "orekitSat"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("H1 CPF  2", "H1 CPF  4", "row 1, column record H1: expected CPF version 1 or 2"),
        ("900 1 1  0 0 0 1", "900 1 1  1 0 0 1", "received an inertial frame, true of date"),
        ("900 1 1  0 0 0 1", "900 1 1", "row 2, column record H2: expected 20 fields; received 18"),
        (
            "29401194.353",
            "2940x194.353",
            "row 8, column record 10: expected a number; received '2940x194.353'",
        ),
        ("29401194.353", "29401194e9", "expected a number from -2000000000 to 2000000000"),
        ("10 0 58282      0.0", "10 1 58282      0.0", "expected instantaneous positions (direction 0)"),
        ("58282      0.000000  0", "58282      0.000000  1", "expected no leap second (0); received '1'"),
        ("58282      0.000000", "58282  99990.000000", "expected a number from 0 to 86401"),
        ("58282      0.000000", "58282    900.000000", "expected each time of orekitSat once"),
        ("10 0 58282      0.0", "19 0 58282      0.0", "expected a CPF record"),
        ("99\n", "", "expected record 99 at the end; received none. The file is cut off"),
        (CPF[CPF.index("10 0") :], "", "expected positions (records 10) of a laser ranging prediction"),
    ],
)
def test_what_is_wrong_in_a_prediction_is_refused_by_its_line(old, new, said):
    assert old in CPF
    with pytest.raises(UserError) as caught:
        cpf(CPF.replace(old, new, 1))
    assert str(caught.value).startswith("a.cpf")
    assert said in str(caught.value)


def test_satellites_of_a_precise_ephemeris_are_trajectories():
    notes = []
    found = sp3(note=notes.append)
    first, second = found.tracks
    assert (found.frame, found.clock) == ("ITRF, EARTH, GPS", "GPS")
    assert found.epoch == instant("2024-03-01", utc=False)
    assert (first.name, first.times.tolist()) == ("G01", [0.0, 900.0, 1800.0])
    assert first.values[0] == pytest.approx(
        [15000.123456, -20000.654321, 8000.000001, -1.2, 0.5, 3.1], rel=1e-14
    )
    assert (second.name, second.times.tolist()) == ("L52", [0.0, 1800.0])
    assert second.values[1, :3].tolist() == [7200.0, 6200.0, 8200.0]
    assert [one.what for one in notes if isinstance(one, Remark)] == [
        "positions missing: 1",
        "positions predicted: 1",
        "frame IGS20 is treated as ITRF; clocks and accuracies are not used",
    ]


@pytest.mark.parametrize(
    ("system", "clock"), [("GAL", "GPS"), ("TAI", "TAI"), ("UTC", "UTC"), ("GLO", "UTC")]
)
def test_time_systems_and_positions_alone(system, clock):
    text = SP3.replace("cc GPS", f"cc {system}").replace("#dV", "#cP")
    found = sp3("".join(line for line in text.splitlines(keepends=True) if line[0] != "V"))
    assert (found.clock, found.rates, found.tracks[0].values.shape) == (clock, (), (3, 3))
    assert found.epoch == instant("2024-03-01", utc=clock == "UTC")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("#dV", "#aV", "row 1: expected #c or #d, as in SP3 orbit files; received '#aV'. Versions a and b"),
        ("IGS20", "UNDEF", "row 1, column frame: expected a frame that rotates with the Earth"),
        ("       3 ORBIT", "       4 ORBIT", "expected 4 epochs and EOF; received 3. The file is cut off"),
        ("EOF\n", "", "expected 3 epochs and EOF; received 3 without EOF"),
        ("cc GPS", "cc BDT", "row 5, column time system: expected one of GPS, GAL, QZS, UTC, GLO, TAI"),
        ("15100.123456", "15100.12x456", "row 16, column position of G01: expected a number"),
        (" 15100.123456 -20100.654321   8100", "     1.000000      2.000000      1", "km from the centre"),
        ("*  2024  3  1  0 15", "*  2024  3 41  0 15", "row 15: expected a calendar date"),
        ("*  2024  3  1  0 15", "*  2024  3  1  0  0", "expected each time of G01 once; received 0.0, which"),
        (
            "VG01 -12000.000000",
            "VG02 -12000.000000",
            "column velocity of G02: expected a position of the sat",
        ),
        ("VG01 -12000.000000", "VG01-912000.000000", "a velocity of at most 12 km/s; received 91.3 km/s"),
        ("/* made", "<> made", "row 9: expected a line of an SP3 orbit file; received '<> made'"),
        (SP3[SP3.index("*  2024") :], "", "expected positions (lines P) in an SP3 orbit file"),
    ],
)
def test_what_is_wrong_in_a_precise_ephemeris_is_refused_by_its_line(old, new, said):
    assert old in SP3
    with pytest.raises(UserError) as caught:
        sp3(SP3.replace(old, new, 1))
    assert str(caught.value).startswith("a.sp3")
    assert said in str(caught.value)


@pytest.mark.parametrize(("name", "text"), [("a.txt", CPF), ("b.csv", SP3)])
def test_both_are_data_whatever_their_names(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    found = parsed(tmp_path / name, *bytes_of(tmp_path / name), FileReading(frame="GCRF"), lambda _: None)
    assert found.frame.startswith("GCRF, EARTH")
    plain = parsed(tmp_path / name, *bytes_of(tmp_path / name), FileReading(), lambda _: None)
    for one, other in zip(found.tracks, plain.tracks, strict=True):
        lengths = [np.linalg.norm(part.values[:, :3], axis=1) for part in (one, other)]
        assert np.allclose(*lengths, rtol=1e-14)
        assert np.abs(one.values[:, :3] - other.values[:, :3]).max() > 1000


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_the_real_prediction_circles_the_earth():
    (path,) = (REAL / "lageos2").glob("*.sgf")
    found = read_cpf(path)
    (track,) = found.tracks
    assert (track.name, len(track.times), found.rates) == ("lageos2", 288, ())
    assert found.epoch == instant("2016-02-13", utc=True)
    assert set(np.diff(track.times)) == {300.0}
    data = Files("lageos2", str(path), frame="GCRF")
    q = data.trajectories.states[0, :, :3].numpy()
    change = (q[2:] - 2 * q[1:-1] + q[:-2]) / 300**2
    radius = np.linalg.norm(q[1:-1], axis=1, keepdims=True)
    pull = -398600.4418 * q[1:-1] / radius**3
    assert np.linalg.norm(change - pull, axis=1).max() / np.linalg.norm(pull, axis=1).max() < 0.02
    assert data.epoch is not None
    assert data.epoch % SECOND == 0
