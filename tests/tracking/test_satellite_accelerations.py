"""Accelerations against potentials, limits and numbers of others, their derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from earth import bodies, rotation

from ahnn.systems.gravity import eigen6s, ggm05c
from ahnn.tracking.accelerations.acceleration_of_time import (
    AccelerationOfTime,
    CubicSplines,
    Powers,
    orbital_axes,
)
from ahnn.tracking.accelerations.atmospheres import DAY, HEIGHTS, LAG, NIGHT, HarrisPriester, atmosphere
from ahnn.tracking.accelerations.atmospheric_drag import AtmosphericDrag
from ahnn.tracking.accelerations.earth_gravity import EarthGravity
from ahnn.tracking.accelerations.earth_tide import LOVE, RADIUS, EarthTide
from ahnn.tracking.accelerations.radiation_pressure import RadiationPressure, lit_fraction
from ahnn.tracking.accelerations.relativity import LIGHT, SchwarzschildTerm
from ahnn.tracking.accelerations.third_body import ThirdBody
from ahnn.tracking.satellite_arc import Forces

pytest.importorskip("erfa")
R, V = np.array([7526.99, -9646.31, 1464.11]), np.array([3.033, 1.715, -4.447])
BODY = np.array([-250000.0, 270000.0, 90000.0])
MU = 398600.4415


def terms():
    def body(t):
        return BODY + 0.1 * t

    return [
        EarthGravity(eigen6s(), rotation()),
        EarthGravity(eigen6s().cut(6, 2), rotation()),
        ThirdBody(4902.8, body),
        EarthTide(4902.8, body),
        SchwarzschildTerm(MU),
        RadiationPressure(0.01, lambda t: 400 * body(t)),
        AtmosphericDrag(0.01),
        AtmosphericDrag(0.01, HarrisPriester(body, 4.0)),
        AccelerationOfTime(Powers(0.0, 1000.0, 2, 1e-7), "inertial"),
        AccelerationOfTime(CubicSplines(0.0, 1000.0, 4, 1e-7), "inertial"),
    ]


@pytest.mark.parametrize("term", terms(), ids=lambda term: type(term).__name__)
def test_derivatives_are_differences(term):
    p = np.linspace(0.5, 1.5, len(term.parameters))
    r = 0.58 * R if isinstance(term, AtmosphericDrag) else R
    found = term(300.0, r, V, p)
    for by, base, size, place in (
        (found.by_position, r, 1.0, 0),
        (found.by_velocity, V, 1e-3, 1),
        (found.by_parameters, p, 1e-2, 2),
    ):
        for k in range(len(base)):
            moved = [np.array(one) for one in (r, V, p)]
            values = []
            for sign in (1, -1):
                moved[place] = base.copy()
                moved[place][k] += sign * size
                values.append(term(300.0, *moved).value)
            slope = (values[0] - values[1]) / (2 * size)
            most = max(np.abs(by).max(), 1e-9 * np.abs(found.value).max())
            assert slope == pytest.approx(by[:, k], abs=2e-5 * most)


def test_many_states_at_once_are_one_after_the_other():
    forces, rng = Forces(terms()), np.random.default_rng(0)
    states = np.concatenate((R, V)) * rng.uniform(0.6, 1.0, (5, 1)) + rng.normal(size=(5, 6)) * [
        9,
        9,
        9,
        0,
        0,
        0,
    ]
    states[0, :3] = -7000.0 * BODY / np.linalg.norm(BODY)  # in the shadow
    p = rng.uniform(0.5, 1.5, (5, len(forces.parameters)))
    whole = forces.acceleration(300.0, states, p)
    for k in range(5):
        for many, one in zip(whole, forces.acceleration(300.0, states[k], p[k]), strict=True):
            assert many[k] == pytest.approx(one, rel=1e-12, abs=1e-13 * np.abs(one).max())


@pytest.mark.parametrize("field", [ggm05c(), eigen6s(), eigen6s().cut(9, 3)], ids=["8", "12", "9x3"])
def test_gravity_is_that_of_the_field_in_axes_that_turn(field):
    turn = rotation().matrices(np.array([500.0]))[0]
    there = torch.from_numpy(turn @ R)
    found = EarthGravity(field, rotation())(500.0, R, V, np.empty(0))
    assert turn @ found.value == pytest.approx(field.attraction(there).numpy(), rel=1e-13)
    assert np.trace(found.by_position) == pytest.approx(0.0, abs=1e-12 * np.abs(found.by_position).max())


def test_two_fields_of_the_earth_agree_to_what_they_are_known():
    difference = np.abs(eigen6s().cut(8, 8).cosines - ggm05c("tide_free").cosines)
    assert difference.max() < 2e-10
    assert difference[2, 0] > 0


def test_a_tide_is_the_slope_of_its_potential():
    def potential(r):
        away, cosine = np.linalg.norm(BODY), r @ BODY / np.linalg.norm(r) / np.linalg.norm(BODY)
        return LOVE * 4902.8 / away**3 * RADIUS**5 / np.linalg.norm(r) ** 3 * (1.5 * cosine**2 - 0.5)

    slope = [(potential(R + d) - potential(R - d)) / 2 for d in np.eye(3)]
    found = EarthTide(4902.8, lambda _: BODY)(0.0, R, V, np.empty(0)).value
    assert found == pytest.approx(slope, rel=1e-6)


def test_relativity_on_a_circle_points_outward_with_three_mu_squared():
    r, v = np.array([12000.0, 0, 0]), np.array([0, (MU / 12000.0) ** 0.5, 0])
    found = SchwarzschildTerm(MU)(0.0, r, v, np.empty(0)).value
    assert found == pytest.approx([3 * MU**2 / (LIGHT**2 * 12000.0**3), 0, 0], rel=1e-12)


def test_the_shadow_is_dark_behind_the_earth_and_half_at_its_edge():
    sun = np.array([1.496e8, 0, 0])
    assert lit_fraction(np.array([-7000.0, 0, 0]), sun) == 0.0
    assert lit_fraction(np.array([7000.0, 0, 0]), sun) == 1.0
    assert lit_fraction(np.array([0.0, 7000.0, 0]), sun) == 1.0
    edges = np.array([lit_fraction(np.array([-42164.0, y, 0]), sun) for y in np.linspace(6000, 6800, 401)])
    assert (np.diff(edges) >= 0).all()
    assert edges[0] == 0
    assert edges[-1] == 1
    # Its middle is where the Sun's centre sets: tan(b) = y / x of the satellite.
    middle = np.linspace(6000, 6800, 401)[np.searchsorted(edges, 0.5)]
    assert middle == pytest.approx(6378.137, abs=8.0)
    ring = lit_fraction(np.array([-3e6, 0, 0]), sun)  # the Earth before the Sun
    assert ring == pytest.approx(1 - (6378.137 / 3e6 / (695700 / 1.526e8)) ** 2, rel=1e-3)


def test_radiation_pressure_is_four_and_a_half_micropascal_away_from_the_sun():
    term = RadiationPressure(1.0, lambda _: np.array([149597870.7, 0, 0]))
    found = term(0.0, np.array([1.0, 9000, 0]), V, np.array([1.0])).value
    assert found[0] == pytest.approx(-4.54e-9, rel=2e-3)  # km/s^2 at 1 m^2/kg
    assert abs(found[1]) < 1e-3 * abs(found[0])


def test_air_is_that_of_the_table_and_continuous():
    assert atmosphere(450.0) == (pytest.approx(1.585e-12), 60.828)
    for height in (180.0, 500.0, 700.0, 1000.0):
        assert atmosphere(height - 1e-9)[0] == pytest.approx(atmosphere(height)[0], rel=0.02)
    still = AtmosphericDrag(0.01)(
        0.0, np.array([7000.0, 0, 0]), np.array([0, 7000 * 7.292115e-5, 0]) + 1e-12, np.ones(1)
    )
    assert np.abs(still.value).max() < 1e-20  # what turns with the air feels none


def test_splines_are_those_of_scipy_and_sum_to_one():
    interpolate = pytest.importorskip("scipy.interpolate")
    basis = CubicSplines(-50.0, 950.0, 5)
    t = np.linspace(-50, 950, 41)
    knots = -50.0 + 200.0 * np.arange(-3, 9)
    theirs = interpolate.BSpline.design_matrix(t, knots, 3).toarray()
    assert basis(t) == pytest.approx(theirs, abs=1e-14)
    assert basis(np.array([-1e3, 2e3])) == pytest.approx(basis(np.array([-50.0, 950.0])))
    assert basis.centres[np.argmax(basis(np.array([350.0])))] == pytest.approx(350.0)


def test_orbital_axes_are_radial_along_and_normal():
    axes = orbital_axes(R, V)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-14)
    assert axes[:, 0] @ R == pytest.approx(np.linalg.norm(R))
    assert axes[:, 1] @ V > 0
    assert axes[:, 2] @ V == pytest.approx(0, abs=1e-14)
    pushed = AccelerationOfTime(Powers(0.0, 1.0, 0, 1.0), "orbital")(0.0, R, V, np.array([0.0, 1.0, 0.0]))
    assert pushed.value == pytest.approx(axes[:, 1])


def test_moon_and_sun_pull_at_the_distance_of_lageos_as_textbooks_say():
    pytest.importorskip("de421")
    found = bodies()
    moon = ThirdBody(4902.8, found.moon)(0.0, R, V, np.empty(0)).value
    sun = ThirdBody(1.327e11, found.sun)(0.0, R, V, np.empty(0)).value
    assert 0.5e-9 < np.linalg.norm(moon) < 3e-9
    assert 0.3e-9 < np.linalg.norm(sun) < 1.5e-9


@pytest.mark.parametrize("exponent", [2.0, 6.0])
def test_air_is_densest_behind_the_sun_and_thinnest_opposite(exponent):
    """The values of the table at 400 km (Montenbruck & Gill 2000, 3.5.2), and between at a right angle."""
    sun = np.array([1.5e8, 0.0, 0.0])
    air = HarrisPriester(lambda _: sun, exponent)
    bulge = np.array([np.cos(LAG), np.sin(LAG), 0.0])
    r = 6778.137 * bulge
    assert air(0.0, r)[0] == pytest.approx(7.492e-12, rel=1e-12)
    assert air(0.0, -r)[0] == pytest.approx(2.249e-12, rel=1e-12)
    across = 6778.137 * np.array([0.0, 0.0, 1.0])
    half = 0.5 ** (exponent / 2)
    assert air(0.0, across)[0] == pytest.approx(2.249e-12 * (1 - half) + 7.492e-12 * half, rel=1e-12)
    between = air(0.0, -6788.137 * bulge)[0]
    assert between == pytest.approx((2.249e-12 * 1.558e-12) ** 0.5, rel=1e-12)  # exponential in between
    assert len(HEIGHTS) == len(DAY) == len(NIGHT) == 50
