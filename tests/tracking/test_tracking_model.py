"""Ranges and angles by light that takes time, against ways to the same numbers that are not ours."""

from __future__ import annotations

import numpy as np
import pytest
from earth import EPOCH, rotation
from simulated import HOURS, STATIONS, TRUE, data, gravity, model

from ahnn.tracking.accelerations.relativity import LIGHT
from ahnn.tracking.light_path import light_path
from ahnn.tracking.satellite_arc import Forces, satellite_arc

pytest.importorskip("erfa")
pytest.importorskip("de421")


@pytest.fixture(scope="module")
def arc():
    return satellite_arc(Forces([gravity()]), TRUE, np.empty(0), 0.0, -5.0, 3600.0 * HOURS + 5)


@pytest.mark.parametrize("event", ["receive", "transmit", "bounce"])
def test_light_arrives_when_the_way_is_done(event):
    times = np.array([0.0, 1000.0])
    path = light_path(
        lambda t: np.column_stack((40000 + 3.0 * t, 0 * t, 7.0 * t)),
        lambda t: np.column_stack((6378 + 0 * t, 0.46 * t, 0 * t)),
        times,
        event,
    )
    tagged = {"receive": path.receive, "transmit": path.transmit, "bounce": path.bounce}[event]
    assert (tagged == times).all()
    assert path.bounce - path.transmit == pytest.approx(np.linalg.norm(path.up, axis=1) / LIGHT, abs=1e-12)
    assert path.receive - path.bounce == pytest.approx(np.linalg.norm(path.down, axis=1) / LIGHT, abs=1e-12)
    assert (path.receive > path.bounce).all()


def test_angles_are_those_of_the_topocentric_frame_of_astropy(arc):
    units, coordinates = pytest.importorskip("astropy.units"), pytest.importorskip("astropy.coordinates")
    from astropy.time import Time, TimeDelta

    made = model()
    found = made(arc)
    rows = np.flatnonzero(data().station == 0)[:5]
    satellite = arc.states(found.bounce[rows])[:, :3]
    # The satellite is where light left it; its place among the stations is at reception.
    there = np.einsum("tij,tj->ti", rotation().matrices(data().times[rows]), satellite)
    where = coordinates.EarthLocation.from_geocentric(*(1e3 * STATIONS[0].position) * units.m)
    moment = Time("2016-02-13T16:00:00") + TimeDelta(data().times[rows], format="sec")
    line = coordinates.ITRS(*(there - STATIONS[0].position).T * units.km, obstime=moment, location=where)
    seen = line.transform_to(coordinates.AltAz(obstime=moment, location=where))
    assert found.values[rows, 1] == pytest.approx(seen.az.rad, abs=2e-7)
    assert found.values[rows, 2] == pytest.approx(seen.alt.rad, abs=2e-7)
    assert EPOCH > 0


def test_ranges_are_half_the_way_there_and_back(arc):
    found, made = model("bounce")(arc), model("bounce")
    for k, station in enumerate(STATIONS):
        rows = data().station == k
        t = data().times[rows]
        way = np.linalg.norm(arc.states(t)[:, :3] - made.site(station, t), axis=1)
        assert found.values[rows, 0] == pytest.approx(way, abs=1e-4)  # before and after cancel to v^2 / c^2


def test_derivatives_are_differences(arc):
    made, t = model(), data().times
    base = made(arc)
    for k, size in ((0, 0.1), (1, 0.1), (2, 0.1), (3, 1e-4), (5, 1e-4)):
        moved = [MovedArc(arc, sign * size, k) for sign in (1, -1)]
        values = [made(one).values for one in moved]
        slope = (values[0] - values[1]) / (2 * size)
        for kind in range(6):
            most = np.abs(base.by_state[:, kind]).max() * (1e-4 if k < 3 else 1e-3)
            if kind != 3 and k >= 3:
                continue  # a velocity moves nothing else at the instant
            assert slope[:, kind] == pytest.approx(base.by_state[:, kind, k], abs=max(most, 1e-12))
    assert len(t)


class MovedArc:
    """An arc whose states are all moved by a little in one component."""

    def __init__(self, arc, size, component):
        self.arc, self.size, self.component = arc, size, component

    def states(self, times):
        states = self.arc.states(times)
        states[:, self.component] += self.size
        return states


def test_each_correction_has_its_own_size_and_sign(arc):
    plain = model()(arc)
    high = plain.elevation > np.radians(15)
    expected = {
        ("troposphere", "radio"): (1e-3, 1.5e-2),
        ("troposphere", "laser"): (1e-3, 1.5e-2),
        ("shapiro", True): (3e-6, 3e-5),
        ("centre_of_mass", 0.000251): (-0.000251001, -0.000250999),
    }
    for (name, value), (least, most) in expected.items():
        change = (model(**{name: value})(arc).values - plain.values)[high, 0]
        assert (change >= least).all(), name
        assert (change <= most).all(), name
    for name in ("profile", "p834"):
        lifted = (model(refraction=name)(arc).values - plain.values)[high, 2]
        assert (lifted > 0).all()
        assert (lifted < np.radians(0.1)).all()
    tides = (model(solid_tides=True)(arc).values - plain.values)[high, 0]
    assert 5e-5 < np.abs(tides).max() < 5e-4
