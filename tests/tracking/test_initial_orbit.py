"""Initial orbits: examples of textbooks, and orbits of two bodies in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from earth import REAL
from simulated import TRUE, problem

from ahnn.contents import read_plain
from ahnn.errors import UserError
from ahnn.tracking.initial_orbit import gauss, gibbs, herrick_gibbs, initial_orbit, triple
from ahnn.tracking.orbit_fit import orbit_fit
from ahnn.tracking.orbit_problem import prepared_orbit
from ahnn.tracking.orbit_setup import setup_of
from ahnn.tracking.satellite_arc import satellite_arc
from ahnn.tracking.tracking_station import EARTH_MU

AXIS, ECCENTRICITY = 26560.0, 0.3


def two_bodies(anomaly):
    """State and time at an eccentric anomaly, in a plane that is tilted by 50 degrees."""
    e, root = ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2)
    n = np.sqrt(EARTH_MU / AXIS**3)
    tilt = np.array([[1, 0, 0], [0, np.cos(0.87), -np.sin(0.87)], [0, np.sin(0.87), np.cos(0.87)]])
    r = AXIS * np.array([np.cos(anomaly) - e, root * np.sin(anomaly), 0.0])
    v = AXIS * n / (1 - e * np.cos(anomaly)) * np.array([-np.sin(anomaly), root * np.cos(anomaly), 0.0])
    return tilt @ r, tilt @ v, (anomaly - e * np.sin(anomaly)) / n


def test_gibbs_is_exact_for_two_bodies_and_as_published():
    states = [two_bodies(a) for a in (0.4, 0.9, 1.6)]
    found = gibbs(np.stack([r for r, _, _ in states]))
    assert found == pytest.approx(states[1][1], rel=1e-12)
    # Vallado (2013), example 7-3.
    rows = [[0.0, 0.0, 6378.137], [0.0, -4464.696, -5102.509], [0.0, 5740.323, 3189.068]]
    assert gibbs(np.array(rows)) == pytest.approx([0.0, 5.531147205, -5.191806413], abs=2e-6)
    # Curtis, Orbital Mechanics for Engineering Students (2014), example 5.1.
    rows = [[-294.32, 4265.1, 5986.7], [-1365.5, 3637.6, 6346.8], [-2940.3, 2473.7, 6555.8]]
    assert gibbs(np.array(rows)) == pytest.approx([-6.2174, -4.0122, 1.5990], abs=2e-4)


def test_herrick_and_gibbs_are_exact_to_fourth_order_and_as_published():
    errors = []
    for h in (0.02, 0.01):
        states = [two_bodies(a) for a in (0.9 - h, 0.9, 0.9 + 1.3 * h)]
        places, times = np.stack([r for r, _, _ in states]), np.array([t for _, _, t in states])
        errors.append(np.linalg.norm(herrick_gibbs(places, times) - states[1][1]))
    assert errors[0] < 1e-4
    assert 6 < errors[0] / errors[1] < 20
    # Vallado, Fundamentals of Astrodynamics and Applications (2013), example 7-4; digits of its program.
    rows = [
        [3419.85564, 6019.82602, 2784.60022],
        [2935.91195, 6326.18324, 2660.59584],
        [2434.95202, 6597.38674, 2521.52311],
    ]
    found = herrick_gibbs(np.array(rows), np.array([0.0, 76.48, 153.04]))
    assert found == pytest.approx([-6.441557227, 3.777559607, -1.720567560], rel=1e-7)


def gauss_of_two_bodies(apart):
    """Errors of position and velocity; eccentric anomalies are `apart` and 1.3 times so."""
    sites = np.array([[3489.8, 3430.2, 4078.5], [3460.1, 3460.1, 4078.5], [3429.9, 3490.1, 4078.5]])
    states = [two_bodies(a) for a in (0.9 - apart, 0.9, 0.9 + 1.3 * apart)]
    lines = np.stack([r for r, _, _ in states]) - sites
    unit = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    found = gauss(sites, unit, np.array([t for _, _, t in states])) - np.concatenate(states[1][:2])
    nearest = min(found, key=lambda off: np.linalg.norm(off[:3]))
    return np.linalg.norm(nearest.reshape(2, 3), axis=1)


def test_gauss_comes_nearer_to_two_bodies_with_the_order_of_its_series():
    far, near = gauss_of_two_bodies(0.08), gauss_of_two_bodies(0.04)
    assert near[0] < 1.0  # of 20,000 km
    assert near[1] < 2e-3
    assert 6 < far[0] / near[0] < 20
    assert 3 < far[1] / near[1] < 6


def test_gauss_is_as_published():
    """Curtis (2014), example 5.11, before improvement: its printed digits and those of its program."""

    def found(sidereal, ascensions, declinations, times):
        radius, flattening, height, latitude = 6378.0, 0.003353, 1.0, np.radians(40.0)
        curve = radius / np.sqrt(1 - (2 - flattening) * flattening * np.sin(latitude) ** 2)
        across, up = (curve + height) * np.cos(latitude), (curve * (1 - flattening) ** 2 + height)
        t, a, d = np.radians([sidereal, ascensions, declinations])
        sites = np.column_stack((across * np.cos(t), across * np.sin(t), 0 * t + up * np.sin(latitude)))
        unit = np.column_stack((np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)))
        (state,) = gauss(sites, unit, np.array(times))
        return state

    printed = found(
        [44.506, 45.0, 45.499], [43.537, 54.42, 64.318], [-8.7833, -12.074, -15.105], [0, 118.1, 237.58]
    )
    assert printed[:3] == pytest.approx([5659.8, 6534.8, 3270.1], abs=0.3)
    assert printed[3:] == pytest.approx([-3.8791, 5.1196, -2.2409], abs=1e-4)
    program = found(
        [44.5065, 45.0, 45.4992],
        [43.5365, 54.4196, 64.3178],
        [-8.78334, -12.0739, -15.1054],
        [0, 118.104, 237.577],
    )
    assert program[:3] == pytest.approx([5659.03, 6533.74, 3270.15], abs=0.01)
    assert program[3:] == pytest.approx([-3.8797, 5.11565, -2.2397], abs=1e-5)


@pytest.mark.parametrize("ranges", [True, False])
def test_a_fit_begins_at_the_measurements_themselves(ranges):
    pytest.importorskip("erfa")
    pytest.importorskip("de421")
    made, _ = problem()
    if not ranges:
        values = made.model.data.values.copy()
        values[:, 0] = np.nan
        made = replace(
            made, model=made.model.of(made.model.stations, replace(made.model.data, values=values))
        )
    state, time = initial_orbit(made.model)
    mean = np.concatenate((state, made.unknowns.mean[6:]))
    fit = orbit_fit(replace(made, at=time, unknowns=replace(made.unknowns, mean=mean)))
    at_zero = fit.point.arc.states(np.zeros(1))[0] - TRUE
    assert np.linalg.norm(at_zero[:3]) < (0.05 if ranges else 5.0)


def test_ranges_alone_give_no_orbit():
    pytest.importorskip("erfa")
    pytest.importorskip("de421")
    made, _ = problem(kinds=1)
    with pytest.raises(UserError, match="start: expected a position and a velocity, or a station that"):
        initial_orbit(made.model)
    assert triple(np.ones((5, 3))) is None


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_w3b_begins_within_tens_of_kilometres_of_its_published_start():
    values = read_plain(Path(__file__).parents[2] / "docs" / "orbits" / "w3b.yaml")
    values["forces"] = {"gravity": {"degree": 2, "order": 0}}
    setup, folder = setup_of(values), REAL / "w3b"
    given, found = (prepared_orbit(one, folder).problem for one in (setup, replace(setup, start=None)))
    start = given.unknowns.mean[:6]
    arc = satellite_arc(given.forces, start, np.empty(0), given.at, given.at - 1, found.at + 1)
    off = found.unknowns.mean[:6] - arc.states(np.array([found.at]))[0]
    assert np.linalg.norm(off[:3]) < 100
    assert np.linalg.norm(off[3:]) < 0.1
