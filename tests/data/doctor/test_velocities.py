"""Velocities held against the change of their positions: which unit is wrong, and whose velocity it is."""

from __future__ import annotations

import numpy as np
import pytest
from entry import call

from ahnn.data.doctor import examine
from ahnn.data.doctor.samples import constant, noise
from ahnn.data.doctor.velocities import (
    VelocityComparison,
    compared,
    misfit,
    velocity_findings,
    weighted_median,
)
from ahnn.data.files import Ephemeris, instant, write_oem
from ahnn.data.files.content import Content
from ahnn.data.files.reading import FileReading
from ahnn.data.files.samples import Track
from ahnn.types import Units

UNITS = Units("s", "m", "m/s", "m²/s²")


def swing(name="a", factor=1.0, count=60, first=2):
    """An oscillator whose velocity is stated so many times too large."""
    t = 0.05 * np.arange(count)
    values = np.stack((np.cos(2 * t + 0.3), -2 * factor * np.sin(2 * t + 0.3)), axis=1)
    return Track(name, "a.csv", first + np.arange(count), t, values)


def found(*tracks, momenta=False, mass=1.0):
    content = Content(("q",), ("v",), momenta, UNITS, "", tracks, head=1)
    return velocity_findings(content, list(tracks), mass)


UNITS_TAKEN = [
    (1000.0, "metres given as km"),
    (60.0, "minutes given as s"),
    (3600.0, "hours given as s"),
    (180 / np.pi, "degrees given as rad"),
    (100.0, "centimetres given as m"),
    (86400.0, "days given as s"),
]


def test_a_factor_between_units_is_named_whichever_is_the_larger():
    for factor, said in UNITS_TAKEN:
        for ratio in (factor, 1 / factor):
            (one,) = found(swing(factor=ratio))
            assert (one.level, one.what) == ("fault", f"v is {ratio:.4g} times the change in q per s")
            assert one.remedy.startswith(f"Correct the unit: {said}")


def test_other_factors_and_those_of_the_wrong_sign_are_no_unit():
    for ratio in (-1000.0, -0.001, 1100.0, 930.0, 2.0, 0.5):
        (one,) = found(swing(factor=ratio))
        assert one.what == f"v is {ratio:.4g} times the change in q per s"
        assert one.remedy.startswith("If it is a momentum")


def test_what_is_not_even_proportional_is_told_apart():
    track = swing()
    track.values[:, 1] = np.cos(7 * track.times)
    (one,) = found(track)
    assert one.what == "v is neither the change in q per s nor proportional to it"


def test_two_percent_need_no_explanation_and_four_do():
    assert found(swing(factor=1.02)) == found(swing(factor=0.98)) == []
    assert len(found(swing(factor=1.04))) == len(found(swing(factor=0.96))) == 1


def test_momenta_are_over_the_mass_and_a_doubt_about_them_is_a_warning():
    assert found(swing(factor=4.0), momenta=True, mass=4.0) == []
    (one,) = found(swing(factor=8.0), momenta=True, mass=4.0)
    assert (one.level, one.what) == ("warning", "v over the mass is 2 times the change in q per s")
    assert one.remedy == "If its unit is right, its mass is 2 times the stated one: correct it (inertia)"
    assert len(found(swing(factor=8.0), mass=8.0)) == 1  # of a velocity the mass does not count


@pytest.mark.parametrize(("wrong", "rows"), [(19, [1]), (17, [200 * k for k in range(17)])])
def test_where_nearly_all_are_wrong_it_is_the_column_and_else_each_trajectory(wrong, rows):
    tracks = [swing(str(k), 100.0 if k < wrong else 1.0, first=200 * k) for k in range(20)]
    assert [one.row for one in found(*tracks)] == rows


def test_short_trajectories_are_judged_together():
    short = [swing(str(k), 60.0 if k == 2 else 1.0, count=9) for k in range(6)]
    assert found(*short) == []
    (one,) = found(*[swing(str(k), 60.0, count=9) for k in range(6)])
    assert one.what == "v is 60 times the change in q per s"
    longer = [swing(str(k), 60.0 if k == 2 else 1.0, count=16, first=100 * k) for k in range(6)]
    assert [one.row for one in found(*longer)] == [200]


def test_nothing_is_said_of_what_nobody_can_tell():
    assert found(swing(factor=60.0, count=6)) == []
    rest = swing()
    assert found(rest._replace(values=0.0 * rest.values)) == []
    rough = swing(factor=60.0)
    rough.values[:, 1] *= np.random.default_rng(0).standard_normal(60)
    assert found(rough) == []


def test_missing_numbers_are_left_out_of_the_comparison():
    track = swing()
    track.values[20, 0] = track.values[40, 1] = np.nan
    pairs = compared(track, 1, 1.0)
    assert pairs is not None
    assert len(pairs.stated) < 56
    assert all(np.isfinite(part).all() for part in pairs)
    assert misfit(pairs, 0) == 1
    assert found(track) == []


def test_a_column_of_a_message_has_no_row(tmp_path):
    t = 60.0 * np.arange(40)
    rate = np.sqrt(398600.4418 / 7000.0**3)
    q = 7000.0 * np.stack((np.cos(rate * t), np.sin(rate * t), 0.1 * np.cos(rate * t)), axis=1)
    v = 7.0e6 * rate * np.stack((-np.sin(rate * t), np.cos(rate * t), -0.1 * np.sin(rate * t)), axis=1)
    start = instant("2024-03-01T12:00:00", utc=True)
    given = Ephemeris("1", "S", "EARTH", "EME2000", "UTC", start, t, np.hstack((q, v)))
    write_oem(tmp_path / "a.oem", [given])
    faults = [
        one for one in examine([tmp_path / "a.oem"], FileReading()).faults if one.column.startswith("v")
    ]
    assert [(one.row, one.column) for one in faults] == [(0, "vx"), (0, "vy"), (0, "vz")]


def irregular(factor):
    """A table of a spring whose step is once so many times longer than the others, which lie on no grid."""
    steps = np.random.default_rng(0).uniform(0.8, 1.2, 60)
    steps[30] = factor * np.median(steps)
    t = 0.05 * np.cumsum(steps)
    return "t,q,v\n" + "".join(f"{s:.17g},{np.cos(s):.17g},{-np.sin(s):.17g}\n" for s in t)


@pytest.mark.parametrize(
    ("factor", "option", "count"), [(12, [], 1), (9, [], 0), (9, ["gap=8"], 1), (12, ["gap=13"], 0)]
)
def test_the_command_takes_ten_usual_steps_for_a_gap_unless_told(tmp_path, capsys, factor, option, count):
    (tmp_path / "a.csv").write_text(irregular(factor))
    assert call("ahnn.data.__main__", "check", str(tmp_path / "a.csv"), *option) == 0
    shown = capsys.readouterr().out
    assert f"0 faults, {1 + count} warning" in shown
    assert ("a gap of " in shown) == bool(count)


@pytest.mark.parametrize("momenta", [False, True])
def test_noise_has_the_unit_of_its_column_and_that_of_momenta_is_not_told(momenta):
    draw = np.random.default_rng(1)
    track = swing(count=400)
    track.values[:] += [0.01, 0.03] * draw.standard_normal(track.values.shape)
    content = Content(("q",), ("v",), momenta, UNITS, "", (track,), head=1)
    position, rate = noise(content, ("q", "v"), 10.0)
    assert [one.level for one in (position, rate)] == ["note", "note"]
    assert float(position.what.split()[3]) == pytest.approx(0.01, rel=0.15)
    assert float(rate.what.split()[3]) == pytest.approx(0.03, rel=0.15)
    assert position.what.endswith(" m")
    assert rate.what.endswith(" m/s") != momenta


def test_columns_that_never_change_take_three_samples_to_be_seen():
    for count in (2, 3):
        track = swing(count=count)
        track.values[:, 1] = 0.25
        content = Content(("q",), ("v",), False, UNITS, "", (track,), head=1)
        found = [(one.level, one.column, one.what) for one in constant(content, ("q", "v"))]
        assert found == ([("warning", "v", "always 0.25")] if count == 3 else [])


def ratio(stated, derived, doubt):
    """What is said of 60 samples, which repeat the given ones."""
    stated, derived = (np.resize(np.asarray(part, dtype=float), 60)[:, None] for part in (stated, derived))
    return misfit(VelocityComparison(stated, derived, np.full((60, 1), doubt)), 0)


def test_two_samples_tell_a_ratio_and_one_tells_none():
    three, one, little = np.full((2, 1), 3.0), np.ones((2, 1)), np.full((2, 1), 1e-9)
    assert misfit(VelocityComparison(three, one, little), 0) == pytest.approx(3.0)
    assert misfit(VelocityComparison(three[:1], one[:1], little[:1]), 0) is None


@pytest.mark.parametrize(("share", "right"), [(0.079, True), (0.081, False)])
def test_eight_doubts_explain_a_difference(share, right):
    for sign in (1, -1):
        assert ratio(1 + sign * share, 1.0, 0.01) == (1.0 if right else pytest.approx(1 + sign * share))


@pytest.mark.parametrize(("doubt", "told"), [(0.299, True), (0.301, False)])
def test_nothing_is_said_of_doubts_beyond_a_tenth_of_the_larger_velocity(doubt, told):
    assert (ratio(3.0, 1.0, doubt) is not None) == told
    assert (ratio(1.0, 3.0, doubt) is not None) == told
    assert ratio([3.0, 3.0, 0.0], 1.0, doubt) is None or told  # three quarters are no larger than 3
    assert ratio([3.0, 0.0, 0.0, 0.0, 0.0], 0.01, doubt) is None


@pytest.mark.parametrize(
    ("spread", "doubt", "proportional"),
    [(0.029, 1e-6, True), (0.033, 1e-6, False), (0.075, 0.02, True), (0.085, 0.02, False)],
)
def test_velocities_are_proportional_up_to_three_percent_or_eight_doubts(spread, doubt, proportional):
    """Twice the derivative, more and less in turn."""
    found = ratio([2 - 2 * spread, 2, 2 + 2 * spread], 1.0, doubt)
    assert found == (pytest.approx(2.0) if proportional else 0.0)


@pytest.mark.parametrize(("count", "rows"), [(11, []), (12, [200])])
def test_eight_derivatives_judge_a_trajectory_by_itself(count, rows):
    tracks = [swing(str(k), 60.0 if k == 2 else 1.0, count=count, first=100 * k) for k in range(6)]
    assert [one.row for one in found(*tracks)] == rows


def test_a_ratio_is_the_middle_one_by_the_size_of_the_derivatives():
    heavy = np.array([[1.0], [1.0], [1.0], [2.5], [0.0]])
    assert weighted_median(np.array([5.0, 6.0, 7.0, 7.5, 9.0]), heavy[:, 0]) == 5.0
    assert weighted_median(np.array([2.0, 6.0, 7.0, 10.0, 9.0]), heavy[:, 0]) == 4.0
    assert weighted_median(heavy[:, 0], 0 * heavy[:, 0]) == 0.0


def test_columns_in_each_others_place_are_named():
    for track in (swing(), swing(count=12)):
        other = [track._replace(values=track.values[:, ::-1], name=name) for name in "abc"]
        (one,) = found(*other)
        assert (one.level, one.row, one.column) == ("fault", 1, "v")
        assert one.what == "q is the change in v per s: the columns seem to be interchanged"
        assert one.remedy == "Interchange the names q and v in the header"


def test_frames_are_mentioned_for_several_coordinates_alone():
    track = swing()
    track.values[:, 1] = np.cos(7 * track.times)
    (one,) = found(track)
    assert one.remedy == "Correct the order or the units of the columns"
    two = track._replace(values=np.repeat(track.values, 2, axis=1))
    content = Content(("x", "y"), ("vx", "vy"), False, UNITS, "", (two,), head=1)
    assert {one.remedy for one in velocity_findings(content, [two], 1.0)} == {
        "Give both in one inertial frame"
    }
