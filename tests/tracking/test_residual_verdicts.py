"""What is said of residuals: what they were made with, and nothing of those that are noise."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.errors import UserError
from ahnn.systems.gravity import eigen6s
from ahnn.systems.gravity.ggm05c import PERMANENT_TIDE
from ahnn.tracking.orbit_forces import gravity_field
from ahnn.tracking.orbit_setup import GravityChoice, OrbitSetup, setup_of
from ahnn.tracking.residual_table import (
    ResidualRow,
    correlation_of,
    effective,
    event_lines,
    table_lines,
    trend_of,
    verdict,
)

T = np.linspace(0, 36000, 200)
WHITE = 1e-3 * np.random.default_rng(0).standard_normal(200)


def said(e, noise=1e-3, bias=(np.nan, np.nan)):
    numbers = float(e.mean()), float(e.std()), trend_of(T, e), correlation_of(e)
    return verdict(ResidualRow("here", "range", len(e), *numbers, noise, bias))


def test_noise_fits():
    assert said(WHITE - WHITE.mean()) == "fits"


def test_a_bias_a_drift_a_wide_scatter_and_likeness_are_said():
    assert said(WHITE + 2e-3).startswith("a bias of 2.0")
    assert "estimate a bias" in said(WHITE + 2e-3)
    assert "its prior is too narrow" in said(WHITE + 2e-3, bias=(0.0, 1e-6))
    drift = said(WHITE + 2e-3 * (T - T.mean()) / 3600 / 2)
    assert "drifts by +1 m an hour" in drift or "drifts by +0.9" in drift or "drifts by +1." in drift
    assert "the scatter is 4" in said(4 * WHITE / WHITE.std() * 1e-3 - 4e-3 * WHITE.mean() / WHITE.std())
    wave = 1e-3 * np.sin(T / 900.0)
    assert "successive residuals correlate" in said(wave)


def test_a_bias_of_the_other_sign_is_said():
    def of(mean, bias, given):
        numbers = float(mean), 1e-3, (0.0, np.inf), 0.0
        return verdict(ResidualRow("here", "range", 50, *numbers, 1e-3, bias, given))

    # Given as +20 m and kept, it leaves -40 m; estimated from a wide prior, it comes out as -20 m.
    assert of(-0.036, (0.02, 0.0), 0.02).startswith(
        "the given bias, 20 m, has the wrong sign; a bias of -36 m"
    )
    assert of(0.0, (-0.0195, 1e-3), 0.02) == "the given bias, 20 m, has the wrong sign"
    assert of(0.0, (0.0195, 1e-3), 0.02) == "fits"
    assert "sign" not in of(-0.01, (0.02, 0.0), 0.02)


@pytest.mark.parametrize(
    ("kind", "sd", "trend", "named"),
    [
        ("range", 1e-3, (0.0, np.inf), False),
        ("range", 3e-3, (0.0, np.inf), True),
        ("range", 1e-3, (1e-6, 1e-7), True),
        ("azimuth", 3e-3, (1e-6, 1e-7), False),
    ],
)
def test_light_time_is_a_possible_cause_of_ranges_that_drift_or_scatter(kind, sd, trend, named):
    row = ResidualRow("here", kind, 50, 0.0, sd, trend, 0.0, 1e-3, (np.nan, np.nan))
    lines = event_lines([row], "transmit")
    assert len(lines) == named
    assert all("those of transmission (event: transmit)" in line for line in lines)


def test_columns_are_as_wide_as_the_longest_names():
    numbers = 50, 0.0, 1e-3, (0.0, np.inf), 0.0, 1e-3, (np.nan, np.nan)
    pairs = ("hartebeesthoek", "range"), ("here", "right_ascension")
    head, *lines = table_lines([ResidualRow(*pair, *numbers) for pair in pairs])
    for line, (station, kind) in zip(lines, pairs, strict=True):
        assert line.index(f"{station} ") == head.index("station")
        assert line.index(f" {kind}, ") + 1 == head.index("kind ")
        assert line.index(" 50 ") + len(" 50") == head.index("count") + len("count")


def test_likeness_lowers_how_many_count():
    assert effective(100, 0.0) == 100
    assert effective(100, 0.5) == pytest.approx(100 / 3)
    assert effective(100, -0.5) == 100
    assert effective(2, 0.99) == 1.0
    assert correlation_of(np.ones(9)) == 0.0
    assert correlation_of(np.array([1.0, -1, 1, -1, 1, -1])) == pytest.approx(-5 / 6)
    assert trend_of(T[:3], WHITE[:3]) == (0.0, np.inf)


@pytest.mark.parametrize(("name", "published"), [("eigen6s", "tide_free"), ("ggm05c", "zero_tide")])
def test_the_permanent_tide_is_counted_once(name, published):
    with_tides = gravity_field(GravityChoice(field=name), "2016-02-13", tides=True)
    without = gravity_field(GravityChoice(field=name), "2016-02-13", tides=False)
    assert with_tides.cosines[2, 0] - without.cosines[2, 0] == pytest.approx(PERMANENT_TIDE)
    assert (with_tides.tide, without.tide) == ("tide_free", "zero_tide")
    assert published in ("tide_free", "zero_tide")
    lower = gravity_field(GravityChoice(field=name, degree=4, order=2), "2016-02-13", tides=True)
    assert (lower.degree, lower.order) == (4, 2)
    assert eigen6s().cosines[0, 0] == 1


def test_a_setup_is_checked_with_the_place_of_what_is_wrong():
    plain = {
        "measurements": "a.aer",
        "start": {"epoch": "2016-02-13T16:00:00", "position": [1.0, 2, 3], "velocity": [1.0, 2, 3]},
        "noise": {"range": 0.01},
        "stations": {"a": [1.0, 2.0, 3.0]},
    }
    assert isinstance(setup_of(plain), OrbitSetup)
    without = setup_of(plain | {"corrections": {"troposphere": None, "refraction": None}}).corrections
    assert (without.troposphere, without.refraction) == ("none", "none")
    for change, words in (
        ({"start": "here"}, "start: expected a mapping of keys to values; received 'here'"),
        ({"noise": {"range": float("nan")}}, "noise.range: expected a standard deviation > 0; received nan"),
        ({"forces": {"drag": {"area_to_mass": 0.0}}}, "forces.drag.area_to_mass: expected float > 0"),
        ({"forces": {"drag": {"area_to_mass": 1.0, "sd": -1.0}}}, "forces.drag.sd: expected 0 "),
        (
            {"forces": {"learned": {"kind": "deep"}}},
            "forces.learned.kind: expected one of smooth, polynomial",
        ),
        ({"stations": None}, "received neither"),
    ):
        with pytest.raises(UserError) as error:
            setup_of(plain | change)
        assert words in str(error.value)
