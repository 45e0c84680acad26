"""Mistakes that are made on purpose are named, and nothing is named where there is none."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from earth import orientation, rotation
from simulated import STATIONS, TRUE, gravity, problem

from ahnn.tracking.orbit_fit import orbit_fit
from ahnn.tracking.satellite_arc import Forces, satellite_arc
from ahnn.tracking.suspected_mistakes import Turned, orientation_mistake, suspected_mistakes
from ahnn.tracking.tracking_station import geodetic_station

pytest.importorskip("erfa")
pytest.importorskip("de421")


@pytest.fixture(scope="module")
def right():
    """A problem without a mistake, of few measurements."""
    made, _ = problem()
    return replace(made, used=np.arange(len(made.used)) % 4 == 0)


def named(mistaken, earth=None, *, fitted=True):
    point = orbit_fit(mistaken).point if fitted else None
    return " ".join(suspected_mistakes(mistaken, point, earth or rotation()))


def with_angles(right, factor):
    values = right.model.data.values.copy()
    values[:, 1:3] *= factor
    return replace(right, model=right.model.of(STATIONS, replace(right.model.data, values=values)))


def test_nothing_is_named_of_noise(right):
    assert named(right) == ""


@pytest.mark.parametrize(
    ("factor", "said"), [(np.pi / 180, "radians given as degrees"), (180 / np.pi, "degrees given as radians")]
)
def test_angles_in_another_unit_are_named(right, factor, said):
    assert said in named(with_angles(right, factor), fitted=False)


def test_interchanged_stations_are_named(right):
    others = STATIONS[1], STATIONS[0], STATIONS[2]
    mistaken = replace(right, model=right.model.of(others, right.model.data))
    assert "south and east fit at each other's position" in named(mistaken, fitted=False)


def wrong(station, latitude, longitude):
    return geodetic_station(station.name, np.degrees(latitude), np.degrees(longitude), station.height)


@pytest.mark.parametrize("fitted", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_interchanged_coordinates_are_named(right, fitted):
    others = tuple(wrong(one, one.longitude, one.latitude) for one in STATIONS)
    mistaken = replace(right, model=right.model.of(others, right.model.data))
    said = named(mistaken, fitted=fitted)
    assert said == "south, east, north: measurements fit with latitude and longitude interchanged"


def test_a_longitude_that_counts_westwards_is_named(right):
    others = (STATIONS[0], wrong(STATIONS[1], STATIONS[1].latitude, -STATIONS[1].longitude), STATIONS[2])
    mistaken = replace(right, model=right.model.of(others, right.model.data))
    assert named(mistaken, fitted=False).startswith("east: measurements fit with the other sign of the long")


def test_a_station_that_stands_elsewhere_is_named(right):
    others = (geodetic_station("south", -35.0, 148.0, 0.8), *STATIONS[1:])
    mistaken = replace(right, model=right.model.of(others, right.model.data))
    assert named(mistaken).startswith("south has a wrong position or measured another object; the other")


def test_utc_for_ut1_is_named_by_directions_among_the_stars_and_not_by_ranges(right):
    turned = Turned(rotation(), 0.4)
    assert named(replace(right, model=right.model.on(turned)), turned) == ""
    arc = satellite_arc(Forces([gravity()], 450.0), TRUE, np.empty(0), 0.0, -1.0, 18002.0)
    noise = np.array([0.01, np.nan, np.nan, np.nan, 5e-6, 5e-6])
    values = right.model(arc).values + np.random.default_rng(5).standard_normal((200, 6)) * noise
    model = right.model.of(STATIONS, replace(right.model.data, values=values))
    stars = replace(right, model=model, noise=np.tile(noise, (3, 1)))
    assert named(stars) == ""
    said = named(replace(stars, model=model.on(turned)), turned)
    assert said.endswith("UTC given for UT1?")
    assert float(said.split("rotated by ")[1].split()[0]) == pytest.approx(-0.4, abs=0.05)


def test_utc_for_ut1_is_named_by_the_bulletins():
    days = orientation()
    other = days._replace(ut1_utc=0.0 * days.ut1_utc)
    assert orientation_mistake(days, days, rotation()) == []
    (said,) = orientation_mistake(other, days, rotation())
    assert re.match(
        r"orientation: UT1 - UTC is given as 0.0000 s, but the IERS gives 0.0\d+ s: UTC given", said
    )
