"""Orbits held against the attraction of the body that they are said to circle."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.doctor.orbits import MU, hypothesis, misfit, orbit_findings
from ahnn.data.files.content import Content
from ahnn.data.files.frames import TURN
from ahnn.data.files.samples import Track
from ahnn.types import Units

DAY, AU = 86400.0, 149597870.7


def test_the_attraction_of_a_body_is_that_of_its_satellites():
    for body, axis, period in (
        ("EARTH", 42164.17, 86164.0905),  # a geostationary satellite
        ("SUN", AU, 365.25636 * DAY),
        ("MARS", 9376.0, 0.31891 * DAY),  # Phobos
        ("JUPITER", 421800.0, 1.769138 * DAY),  # Io
        ("SATURN", 1221870.0, 15.945421 * DAY),  # Titan
    ):
        assert MU[body] == pytest.approx(4 * np.pi**2 * axis**3 / period**2, rel=2e-3)


def test_the_attraction_of_a_body_is_that_on_its_ground():
    for body, radius, gravity in (("MOON", 1737.4, 1.625), ("VENUS", 6051.8, 8.87)):
        assert MU[body] == pytest.approx(gravity / 1000 * radius**2, rel=3e-3)


def circle(radius=7000.0, mu=MU["EARTH"], count=80, tilt=0.6):
    """Times, and positions on about one revolution."""
    rate = np.sqrt(mu / radius**3)
    t = 2 * np.pi / rate / count * np.arange(count)
    c, s = np.cos(rate * t), np.sin(rate * t)
    return t, radius * np.stack((c, s * np.cos(tilt), s * np.sin(tilt)), axis=1)


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
    assert hypothesis(t, turning, "EARTH", turning=False) == "positions turn with the Earth"
    assert hypothesis(t, q, "EARTH", turning=True) == "positions are those of an inertial frame"


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
    assert one.what.startswith("no orbit of the Earth: positions are 1000 times too large")
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
    assert one.what.startswith("no orbit of the Moon: positions are 1000 times too large")


def test_the_centre_and_too_few_samples_tell_nothing():
    t, q = circle()
    assert misfit(t[:6], q[:6], [MU["EARTH"]], turned=False) == np.inf
    assert misfit(t, 0 * q, [MU["EARTH"]], turned=False) == np.inf
    rough = q + 2000.0 * np.random.default_rng(0).standard_normal(q.shape)
    assert misfit(t, rough, [MU["EARTH"]], turned=False) == np.inf
