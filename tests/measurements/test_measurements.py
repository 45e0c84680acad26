"""Measurement models against independently coded geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from ahnn.measurements import GnssRange, GroundStation, Position, Several, State, observe, wrap
from ahnn.measurements.ground_station import EARTH_RATE

F64 = torch.float64


def site(latitude, longitude, height, t, angle=0.0, flattening=1.0 / 298.257223563):
    """Inertial position of a site: foot point on the ellipsoid from its parametric latitude, plus height."""
    phi, lam = math.radians(latitude), math.radians(longitude) + angle + EARTH_RATE * t
    parametric = math.atan((1.0 - flattening) * math.tan(phi))
    foot = 6378.137 * np.array([math.cos(parametric), (1.0 - flattening) * math.sin(parametric)])
    rho, z = foot + height * np.array([math.cos(phi), math.sin(phi)])
    return np.array([rho * math.cos(lam), rho * math.sin(lam), z])


def neighbour(latitude, longitude, north=0.0, east=0.0, up=0.0, t=0.0, **options):
    """State at a small geodetic displacement from the site, by differences of site coordinates."""
    here = site(latitude, longitude, 0.0, t, **options)
    to_north = site(latitude + 1e-3, longitude, 0.0, t, **options)
    to_north = to_north - site(latitude - 1e-3, longitude, 0.0, t, **options)
    to_east = site(latitude, longitude + 1e-3, 0.0, t, **options)
    to_east = to_east - site(latitude, longitude - 1e-3, 0.0, t, **options)
    to_up = site(latitude, longitude, 1.0, t, **options) - here
    axes = [v / np.linalg.norm(v) for v in (to_north, to_east, to_up)]
    q = here + north * axes[0] + east * axes[1] + up * axes[2]
    return torch.from_numpy(np.concatenate((q, np.zeros(3))))


@pytest.mark.parametrize("latitude", [-52.0, 0.0, 37.5, 80.0])
@pytest.mark.parametrize("longitude", [-120.0, 15.0])
@pytest.mark.parametrize(
    ("offset", "azimuth", "elevation"),
    [
        ({"north": 10.0}, 0.0, 0.0),
        ({"east": 10.0}, 90.0, 0.0),
        ({"east": -10.0}, -90.0, 0.0),
        ({"north": 10.0, "east": 10.0}, 45.0, 0.0),
        ({"north": 10.0, "up": 10.0}, 0.0, 45.0),
        ({"north": -10.0, "east": -1e-12, "up": -10.0}, 180.0, -45.0),
    ],
)
def test_station_sees_the_compass(latitude, longitude, offset, azimuth, elevation):
    t, angle = 5000.0, 0.7
    station = GroundStation(latitude, longitude, earth_angle=angle)
    x = neighbour(latitude, longitude, t=t, angle=angle, **offset)
    y = station(x, t)
    assert float(y[0]) == pytest.approx(math.hypot(*offset.values()), rel=1e-9)
    assert abs(float(wrap(y[1] - math.radians(azimuth)))) < 1e-7
    assert float(y[2]) == pytest.approx(math.radians(elevation), abs=1e-7)


@pytest.mark.parametrize("latitude", [-90.0, -33.0, 0.0, 45.0, 90.0])
def test_zenith_has_an_elevation_of_ninety_degrees(latitude):
    x = torch.from_numpy(np.concatenate((site(latitude, 70.0, 800.0, 0.0), np.zeros(3))))
    y = GroundStation(latitude, 70.0)(x, 0.0)
    assert float(y[0]) == pytest.approx(800.0, rel=1e-12)
    assert float(y[2]) == pytest.approx(math.pi / 2.0, abs=1e-7)
    assert bool(torch.isfinite(y).all())


def test_a_sphere_and_a_height():
    station = GroundStation(30.0, 0.0, 2.0, flattening=0.0)
    x = torch.tensor([10000.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=F64)
    radius, phi = 6380.137, math.radians(30.0)
    assert float(station(x, 0.0)[0]) == pytest.approx(
        math.hypot(10000.0 - radius * math.cos(phi), radius * math.sin(phi)), rel=1e-14
    )


def test_range_rate_is_the_derivative_of_the_range():
    station = GroundStation(47.0, 11.0, 0.6, range_rate=True, earth_angle=1.0)
    q = torch.tensor([7000.0, 1000.0, 3000.0], dtype=F64)
    v = torch.tensor([-1.0, 6.5, 3.0], dtype=F64)
    h = 1e-2

    def distance(t):
        return station(torch.cat((q + v * t, v)), 100.0 + t)[0]

    numeric = (8.0 * (distance(h) - distance(-h)) - (distance(2 * h) - distance(-2 * h))) / (12.0 * h)
    assert float(station(torch.cat((q, v)), 100.0)[3]) == pytest.approx(float(numeric), rel=1e-8)
    # The Earth's own rotation is in it.
    still = torch.cat((q, torch.zeros(3, dtype=F64)))
    assert abs(float(station(still, 100.0)[3])) > 0.01


def test_station_works_on_batches_of_sigma_points():
    station = GroundStation(47.0, 11.0, range_rate=True)
    x = 7000.0 * torch.randn(4, 13, 6, generator=torch.Generator().manual_seed(0), dtype=F64)
    y = station(x, 3.0)
    assert y.shape == (4, 13, 4) == (4, 13, len(station.names))
    assert torch.allclose(y[2, 5], station(x[2, 5], 3.0), rtol=1e-13)
    more = torch.cat((x, x[..., :2]), dim=-1)  # states with components of a force error
    assert torch.equal(station(more, 3.0), y)


def test_angles_wrap_to_the_half_open_interval():
    pi = math.pi
    angles = torch.tensor([pi, -pi, 3.0 * pi, pi + 0.1, -pi - 0.1, 0.0, 2.0], dtype=F64)
    expected = torch.tensor([pi, pi, pi, 0.1 - pi, pi - 0.1, 0.0, 2.0], dtype=F64)
    assert torch.allclose(wrap(angles), expected, rtol=1e-14, atol=1e-15)


def test_no_angle_wraps_to_just_outside():
    pi = math.pi
    edges = [turn * pi for turn in (-7, -5, -3, -1, 1, 3, 5, 7)]
    near = [math.nextafter(edge, side) for edge in edges for side in (-math.inf, math.inf)]
    wrapped = wrap(torch.tensor(near + edges, dtype=F64))
    assert bool(((wrapped > -pi) & (wrapped <= pi)).all())
    # All of them point backwards.
    assert float((wrapped.abs() - pi).abs().max()) < 1e-13
    inside = torch.tensor([math.nextafter(-pi, 0.0), math.nextafter(pi, 0.0), pi, 1.0, 5e-324], dtype=F64)
    assert torch.equal(wrap(inside), inside)


@given(st.floats(-1e3, 1e3))
def test_wrapping_keeps_the_direction(angle):
    wrapped = float(wrap(torch.tensor(angle, dtype=F64)))
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-11)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-11)


def test_residual_of_azimuths_on_both_sides_of_south():
    station = GroundStation(0.0, 0.0)
    y = torch.tensor([1000.0, math.pi - 0.01, 0.2], dtype=F64)
    y_pred = torch.tensor([1001.0, -math.pi + 0.01, 0.1], dtype=F64)
    expected = torch.tensor([-1.0, -0.02, 0.1], dtype=F64)
    assert torch.allclose(station.residual(y, y_pred), expected, rtol=1e-12)


def test_position_and_state_read_the_state():
    x = torch.arange(6.0, dtype=F64)
    assert Position(3)(x, 0.0).tolist() == [0.0, 1.0, 2.0]
    assert Position(3).names == ("q1", "q2", "q3")
    assert State(3)(x, 0.0).tolist() == x.tolist()
    assert State(1, ("m", "kg m/s")).units == ("m", "kg m/s")


def test_a_station_at_an_impossible_latitude():
    with pytest.raises(ValueError, match="received 91"):
        GroundStation(91.0, 0.0)


def test_the_range_rate_is_that_of_the_velocity_whatever_the_mass():
    x = torch.tensor([7000.0, 1000.0, 3000.0, -1.0, 6.5, 3.0], dtype=F64)
    momenta = torch.cat((x[:3], 2.5 * x[3:]))
    light = GroundStation(47.0, 11.0, range_rate=True)
    heavy = GroundStation(47.0, 11.0, range_rate=True, mass=2.5)
    assert torch.allclose(heavy(momenta, 7.0), light(x, 7.0), rtol=1e-14, atol=0.0)
    with pytest.raises(ValueError, match="mass: expected float > 0; received 0"):
        GroundStation(47.0, 11.0, mass=0.0)


@pytest.mark.parametrize(
    ("model", "size", "least"),
    [
        (GnssRange([[2e4, 0.0, 0.0]], clock=9), 6, 10),
        (GnssRange([[2e4, 0.0, 0.0]], clock=-7), 6, 7),
        (GnssRange([[2e4, 0.0, 0.0]]), 1, 3),
        (GroundStation(0.0, 0.0), 2, 3),
        (GroundStation(0.0, 0.0, range_rate=True), 4, 6),
    ],
)
def test_states_that_are_too_short_for_a_model(model, size, least):
    who = type(model).__name__
    with pytest.raises(
        ValueError, match=rf"{who}: expected states of at least {least} .* received \(5, {size}\)"
    ):
        model(torch.ones(5, size, dtype=F64), 0.0)


@pytest.mark.parametrize("least", [-90.0, 0.0, 10.0])
def test_what_stands_lower_than_the_least_elevation_is_not_observed(least):
    latitude, longitude, t = 47.0, 11.0, 500.0
    station = GroundStation(latitude, longitude, min_elevation=least)
    angles = torch.tensor([-60.0, -1.0, 1.0, 9.0, 11.0, 89.0]).deg2rad().tolist()
    x = torch.stack([neighbour(latitude, longitude, north=math.cos(a), up=math.sin(a), t=t) for a in angles])
    seen = torch.tensor([math.degrees(a) > least for a in angles])
    y = observe(station, x, t)
    assert torch.equal(station.in_view(x, t), seen.unsqueeze(-1).expand(-1, 3))
    assert torch.equal(y[seen], station(x, t)[seen])
    assert bool(y[~seen].isnan().all())
    assert bool(station(x, t).isfinite().all())


def test_a_model_without_a_view_observes_every_state():
    x = torch.arange(6.0, dtype=F64)
    assert observe(Position(3), x, 0.0).tolist() == [0.0, 1.0, 2.0]


def test_a_station_that_looks_down_to_its_nadir_sees_everything():
    beneath = torch.tensor([[-7000.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [7000.0, 0.0, 0.0]], dtype=F64)
    for least, seen in ((-90.0, [True, True, True]), (-89.9, [False, False, True])):
        station = GroundStation(0.0, 0.0, flattening=0.0, min_elevation=least)
        assert station.in_view(beneath, 0.0)[:, 0].tolist() == seen


NUMBERS = ("height", "earth_angle", "rotation_rate", "radius", "flattening", "mass", "min_elevation")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["latitude", "longitude", *NUMBERS])
def test_a_number_that_is_not_finite_is_refused(name, value):
    with pytest.raises(ValueError, match=f"{name}: expected .*float .*; received {value}"):
        GroundStation(**({"latitude": 1.0, "longitude": 2.0} | {name: value}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_elevation": 91.0}, "min_elevation: expected float from -90 to 90; received 91.0"),
        ({"radius": 0.0}, "radius: expected float > 0; received 0.0"),
        ({"flattening": 1.0}, "flattening: expected float >= 0 and < 1; received 1.0"),
    ],
)
def test_impossible_stations(options, message):
    with pytest.raises(ValueError, match=message):
        GroundStation(0.0, 0.0, **options)


def test_a_station_of_which_only_the_place_is_said_stands_on_the_ellipsoid_at_the_meridian():
    plain = GroundStation(40.0, 20.0)
    spelled = GroundStation(
        40.0,
        20.0,
        0.0,
        range_rate=False,
        earth_angle=0.0,
        rotation_rate=EARTH_RATE,
        radius=6378.137,
        flattening=1.0 / 298.257223563,
        mass=1.0,
        min_elevation=0.0,
    )
    x = torch.tensor([[5000.0, 3000.0, 6000.0], [-5000.0, 100.0, -4000.0]], dtype=F64)
    assert plain.names == ("range", "azimuth", "elevation")
    assert torch.equal(plain(x, 900.0), spelled(x, 900.0))
    assert torch.equal(plain.in_view(x, 900.0), spelled.in_view(x, 900.0))
    assert plain.in_view(x, 900.0)[:, 0].tolist() == [True, False]
    assert plain.min_elevation == 0.0
    for limit in (-90.0, 90.0):
        assert GroundStation(limit, 0.0, min_elevation=limit).min_elevation == math.radians(limit)
    with pytest.raises(ValueError, match=r"received -90\.5"):
        GroundStation(-90.5, 0.0)


@pytest.mark.parametrize("model", [Position(2), State(1), GnssRange([[2e4, 0.0, 0.0], [0.0, 2e4, 0.0]])])
def test_residuals_without_angles_are_differences(model):
    y, y_pred = torch.tensor([3.0, -1.0], dtype=F64), torch.tensor([0.5, 4.0], dtype=F64)
    assert model.residual(y, y_pred).tolist() == [2.5, -5.0]


def test_positions_and_states_are_by_default_those_of_three_dimensions():
    assert (Position().names, Position().units) == (("q1", "q2", "q3"), ("km",) * 3)
    assert State().names == ("q1", "q2", "q3", "p1", "p2", "p3")
    assert State().units == ("km",) * 3 + ("km/s",) * 3


def test_several_stations_measure_side_by_side():
    stations = [GroundStation(60.0, 30.0, min_elevation=10.0), GroundStation(60.0, 210.0, min_elevation=10.0)]
    network = Several([*stations, Position(3)])
    x = torch.tensor([[3e3, 2e3, 2.4e4], [-3e3, -2e4, 1.5e4], [0.0, 0.0, -9e3]], dtype=F64)
    t = torch.tensor([0.0, 600.0, 900.0], dtype=F64)
    y = network(x, t)
    assert network.names[3:7] == ("2.range", "2.azimuth", "2.elevation", "3.q1")
    assert torch.equal(y, torch.cat([stations[0](x, t), stations[1](x, t), x], -1))
    seen = observe(network, x, t)
    for k, station in enumerate(stations):
        assert torch.equal(seen[:, 3 * k : 3 * k + 3].isnan(), observe(station, x, t).isnan())
    assert {*seen[..., 0].isnan().tolist()} == {True, False}
    assert torch.equal(seen[..., 6:], x)
    torch.testing.assert_close(network.locate(seen, t), x, rtol=1e-12, atol=0)
    only = Several(stations)
    assert bool(only.locate(observe(only, x, t), t)[2].isnan().all())
    turned = y.clone()
    turned[:, [1, 4]] += 2 * math.pi
    torch.testing.assert_close(network.residual(turned, y), torch.zeros_like(y), rtol=0, atol=1e-14)


def test_several_of_none_is_refused():
    with pytest.raises(ValueError, match="expected at least one measurement model"):
        Several([])
