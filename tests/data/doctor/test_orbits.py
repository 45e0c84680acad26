"""Orbits held against the attraction of the body that they are said to circle."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data import Files
from ahnn.data.doctor.orbits import MU, hypothesis, misfit, orbit_findings
from ahnn.data.doctor.slopes import slopes
from ahnn.data.files.content import Content
from ahnn.data.files.frames import TURN
from ahnn.data.files.samples import Track
from ahnn.types import Units

DAY, AU = 86400.0, 149597870.7


SATELLITES = [
    ("EARTH", 42164.17, 86164.0905),  # geostationary
    ("EARTH", 384399.0, 27.321661 * DAY * (1 + 0.0123) ** 0.5),  # the Moon, which weighs 1.23 % of the Earth
    ("SUN", AU, 365.25636 * DAY),
    ("SUN", 5.2038 * AU, 4332.59 * DAY),  # Jupiter
    ("MARS", 9376.0, 0.31891 * DAY),  # Phobos
    ("MARS", 23463.2, 1.263 * DAY),  # Deimos
    ("JUPITER", 421800.0, 1.769138 * DAY),  # Io
    ("JUPITER", 1882700.0, 16.689017 * DAY),  # Callisto
    ("SATURN", 1221870.0, 15.945421 * DAY),  # Titan
    ("MOON", 1737.4, 2 * np.pi * (1737.4 / 1.625e-3) ** 0.5),  # on the ground, by its gravity
    ("VENUS", 6051.8, 2 * np.pi * (6051.8 / 8.87e-3) ** 0.5),
]
"""Semi-major axes in km and periods in s."""


@pytest.mark.parametrize(("body", "axis", "period"), SATELLITES)
def test_the_attraction_of_a_body_is_that_of_its_satellites(body, axis, period):
    """By Kepler's third law; perturbations are a few thousandths."""
    t, q = circle(axis, 4 * np.pi**2 * axis**3 / period**2)
    assert misfit(t, q, [MU[body]], turned=False) < 5e-3
    assert hypothesis(t, q, body, turning=False) == hypothesis(t, q, None, turning=False) == ""


def circle(radius=7000.0, mu=MU["EARTH"], count=80, tilt=0.6):
    """Times, and positions on about one revolution."""
    rate = np.sqrt(mu / radius**3)
    t = 2 * np.pi / rate / count * np.arange(count)
    c, s = np.cos(rate * t), np.sin(rate * t)
    return t, radius * np.stack((c, s * np.cos(tilt), s * np.sin(tilt)), axis=1)


def transfer_orbit(step, count=600, axis=24400.0, eccentricity=0.73, mu=MU["EARTH"]):
    """Times and positions of an eccentric orbit over several revolutions, by Kepler's equation."""
    t = step * np.arange(count)
    mean = np.sqrt(mu / axis**3) * t
    e = mean + eccentricity * np.sin(mean)
    for _ in range(60):
        e -= (e - eccentricity * np.sin(e) - mean) / (1 - eccentricity * np.cos(e))
    x, y = axis * (np.cos(e) - eccentricity), axis * np.sqrt(1 - eccentricity**2) * np.sin(e)
    return t, np.stack((x, y * np.cos(0.5), y * np.sin(0.5)), axis=1)


@pytest.mark.parametrize("step", [60.0, 180.0, 300.0])
def test_derivatives_are_not_taken_over_periods_of_the_motion(step):
    """A stride of about one revolution sees a slow drift, which is smooth."""
    t, q = transfer_orbit(step)
    assert hypothesis(t, q, "EARTH", turning=False) == ""
    assert "1000 times too large" in hypothesis(t, 1000 * q, "EARTH", turning=False)
    v = slopes(t, q, 1)
    assert v is not None
    speed = np.sqrt(MU["EARTH"] * (2 / np.linalg.norm(q[v.at], axis=1) - 1 / 24400.0))
    assert np.median(np.abs(np.linalg.norm(v.values, axis=1) / speed - 1)) < 0.01


MISTAKES = [
    (1.0, 1000.0, "positions are 1000 times too large (m as km?)"),
    (1.0, 0.001, "positions are 1000 times too small (km as m?)"),
    (1 / 60, 1.0, "times are 60 times too small (min as s?)"),
    (1 / 3600, 1.0, "times are 3600 times too small (h as s?)"),
    (60.0, 1.0, "times are 60 times too large (s as min?)"),
    (3600.0, 1.0, "times are 3600 times too large (s as h?)"),
    (60.0, 1000.0, "positions are 1000 times too large (m as km?) and times are 60 times too large"),
]
"""Factors on times and positions, and what is said of them."""


def test_the_mistake_is_named_that_makes_an_orbit_of_it():
    for clock, length, said in MISTAKES:
        t, q = circle(42164.17 if clock == 3600.0 else 7000.0)
        assert hypothesis(t, q, "EARTH", turning=False) == ""
        assert hypothesis(clock * t, length * q, "EARTH", turning=False).startswith(said)
        assert hypothesis(clock * t, length * q, None, turning=False).startswith(said)


@pytest.mark.parametrize(("axis", "factor", "said"), [(1, 1e3, "too large"), (2, 1e-3, "too small")])
def test_one_column_in_another_unit_is_named(axis, factor, said):
    t, q = circle()
    wrong = q * np.where(np.arange(3) == axis, factor, 1.0)
    name = "xyz"[axis]
    assert hypothesis(t, wrong, "EARTH", turning=False).startswith(f"{name} is 1000 times {said}")
    assert hypothesis(t, wrong, None, turning=False, names=("a", "b", "c")).startswith("abc"[axis])


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01, 1.3])
def test_a_misfit_is_the_relative_difference_of_the_attractions(share):
    t, q = circle(mu=share * MU["EARTH"])
    assert misfit(t, q, [MU["EARTH"]], turned=False) == pytest.approx(abs(share - 1), rel=0.02)
    assert misfit(t, q, [MU["SUN"], share * MU["EARTH"]], turned=False) < 1e-4
    assert hypothesis(t, q, "EARTH", turning=False) == ""


def earth_fixed(t, q):
    c, s = np.cos(TURN * t), np.sin(TURN * t)
    return np.stack((c * q[:, 0] + s * q[:, 1], c * q[:, 1] - s * q[:, 0], q[:, 2]), axis=1)


def test_a_frame_that_turns_is_told_from_one_that_does_not():
    t, q = circle(20000.0)
    turning = earth_fixed(t, q)
    assert misfit(t, turning, [MU["EARTH"]], turned=True) < 1e-4
    assert misfit(t, turning, [MU["EARTH"]], turned=False) > 0.1
    assert hypothesis(t, turning, "EARTH", turning=True) == ""
    assert hypothesis(t, turning, "EARTH", turning=False) == "positions rotate with the Earth"
    assert hypothesis(t, q, "EARTH", turning=True) == "positions are in an inertial frame"


def seen(here, left):
    """Times and positions in the plane of the equator, in a frame that turns with the Earth.

    An attraction that is off by `left` holds the orbit; taken for inertial it is off by `here`.
    """
    share = 1 - np.sqrt((1 - here) / (1 + left))  # of its own rate that the frame turns with
    radius = ((1 + left) * MU["EARTH"] * share**2 / TURN**2) ** (1 / 3)
    t, q = circle(radius, (1 + left) * MU["EARTH"], count=200, tilt=0.0)
    return t, earth_fixed(t, q)


@pytest.mark.parametrize(
    ("here", "left", "named"),
    [
        (0.019, 0.0, False),  # needs no explanation
        (0.021, 0.0, True),
        (0.12, 0.039, True),
        (0.12, 0.041, False),  # a third of it is left
        (0.6, 0.098, True),
        (0.6, 0.102, False),  # too much is left
    ],
)
def test_a_mistake_is_named_where_it_explains_a_difference(here, left, named):
    t, q = seen(here, left)
    assert misfit(t, q, [MU["EARTH"]], turned=False) == pytest.approx(here, abs=1e-4)
    assert misfit(t, q, [MU["EARTH"]], turned=True) == pytest.approx(left, abs=1e-4)
    for body in ("EARTH", None):
        assert hypothesis(t, q, body, turning=False) == ("positions rotate with the Earth" if named else "")


@pytest.mark.parametrize("doubt", [0.02, 0.145, 0.155])
def test_a_misfit_is_that_of_differences_over_five_samples_until_these_are_too_far_apart(doubt):
    """Second differences of three and of five samples of a circle differ by (1 - c) / (7 - c), c = cos h."""
    c = (1 - 7 * doubt) / (1 - doubt)
    angle, radius = np.arccos(c) * np.arange(9), 7000.0
    q = radius * np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    found = misfit(angle * np.sqrt(radius**3 / MU["EARTH"]), q, [MU["EARTH"]], turned=False)
    left = 1 - (7 - c) * (1 - c) / (3 * np.arccos(c) ** 2)
    assert found == (pytest.approx(left, rel=1e-6) if doubt < 0.15 else np.inf)


def test_a_missing_sample_and_one_in_the_centre_do_not_count():
    t, q = circle()
    for lost in (np.nan, 0.0):
        some = q.copy()
        some[30] = lost
        assert misfit(t, some, [MU["EARTH"]], turned=False) < 1e-4


def content(tracks, units=("s", "km"), frame="", names=("x", "y", "z")):
    return Content(names, (), False, Units(*units), frame, tuple(tracks), time="t", head=1)


def tracks(count, wrong, factor=1000.0):
    t, q = circle()
    rows = 2 + np.arange(len(t))
    return [Track(str(k), "a.csv", rows + 100 * k, t, q * (factor if k < wrong else 1)) for k in range(count)]


@pytest.mark.parametrize(("wrong", "rows"), [(0, []), (19, [1]), (17, [2 + 100 * k for k in range(17)])])
def test_where_nearly_all_are_wrong_it_is_the_file_and_else_each_trajectory(wrong, rows):
    given = tracks(20, wrong)
    found = orbit_findings(content(given), given)
    assert [one.row for one in found] == rows
    assert {(one.level, one.column) for one in found} <= {("fault", "x")}


def test_only_orbits_of_a_body_in_lengths_and_times_are_judged():
    given = tracks(1, 1)
    (one,) = orbit_findings(content(given, frame="GCRF, EARTH"), given)
    assert one.what.startswith("not an orbit around the Earth: positions are 1000 times too large")
    assert orbit_findings(content(given, units=("1", "1")), given) == []
    assert orbit_findings(content(given, units=("s", "1")), given) == []
    assert orbit_findings(content(given, units=("1", "km")), given) == []
    assert orbit_findings(content(given, names=("x", "y")), given) == []
    assert orbit_findings(content(given, units=("s", "m")), given) == []  # that is what they are in


def test_units_of_the_file_count():
    t, q = circle()
    for units, times, lengths in ((("min", "km"), t / 60, q), (("s", "m"), t, 1000 * q)):
        given = [Track("", "a.csv", 2 + np.arange(len(t)), times, lengths)]
        assert orbit_findings(content(given, units=units), given) == []


def test_another_body_is_judged_by_its_own_attraction():
    t, q = circle(3000.0, MU["MOON"])
    given = [Track("", "a.csv", 2 + np.arange(len(t)), t, 1000 * q)]
    (one,) = orbit_findings(content(given, frame="ICRF, MOON"), given)
    assert one.what.startswith("not an orbit around the Moon: positions are 1000 times too large")


@pytest.mark.parametrize(
    ("frame", "unknown"),
    [("J2001, EARTH", True), ("J2000, EARTH", False), ("ITRF2014", False), ("EFG", False), ("", False)],
)
def test_a_frame_that_cannot_be_converted_is_named(frame, unknown):
    t, q = circle()
    given = [Track("", "a.csv", 2 + np.arange(len(t)), t, 1000 * q)]
    found = [one.what for one in orbit_findings(content(given, frame=frame), given) if one.level == "warning"]
    assert found == ["frame J2001 is unknown: states in it are not converted"] * unknown


def test_the_centre_and_too_few_samples_tell_nothing():
    t, q = circle()
    assert misfit(t[:6], q[:6], [MU["EARTH"]], turned=False) == np.inf
    assert misfit(t, 0 * q, [MU["EARTH"]], turned=False) == np.inf
    rough = q + 2000.0 * np.random.default_rng(0).standard_normal(q.shape)
    assert misfit(t, rough, [MU["EARTH"]], turned=False) == np.inf


@pytest.mark.parametrize("names", [("x", "y"), ("r_x", "R_y")])
@pytest.mark.parametrize("unit", ["km", "m"])
def test_two_positions_of_a_tilted_orbit_miss_the_third(unit, names):
    factor = 1000.0 if unit == "m" else 1.0
    for tilt, count in ((0.6, 1), (0.35, 1), (0.0, 0)):
        t, q = circle(tilt=tilt)
        given = [Track("", "a.csv", 2 + np.arange(len(t)), t, factor * q[:, :2])]
        found = orbit_findings(content(given, units=("s", unit), names=names), given)
        assert [(one.level, one.row, one.column) for one in found] == [("warning", 1, names[1])] * count
        assert all(one.what.endswith("is z missing?") for one in found)
        small = [given[0]._replace(values=1e-4 * given[0].values)]
        assert orbit_findings(content(small, units=("s", unit), names=names), small) == []


def test_a_missing_position_is_told_before_a_training(tmp_path, caplog):
    t, q = circle()
    rows = [f"{one:.1f},{x:.6f},{y:.6f}" for one, (x, y) in zip(t, q[:, :2], strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t [s],x [km],y [km]", *rows]))
    Files("a", str(tmp_path / "a.csv")).check()
    assert f"{tmp_path / 'a.csv'}, row 1, column y: two positions do not describe an orbit" in caplog.text
