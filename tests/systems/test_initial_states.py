"""Initial states have the elements that were asked for, read back from r and v by textbook formulas."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, generator

from ahnn.errors import UserError

WIDE = dataclasses.replace(MOLNIYA, raan=(0.0, 360.0), argument_of_periapsis=(0.0, 360.0))


def elements(x, mu):
    """Periapsis radius, e, i, RAAN and argument of periapsis (degrees) of orbits started at periapsis."""
    r, v = x.chunk(2, dim=-1)
    h = torch.linalg.cross(r, v)
    pole = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(h)
    node = torch.linalg.cross(pole, h)
    e = torch.linalg.cross(v, h) / mu - r / r.norm(dim=-1, keepdim=True)
    inclination = torch.rad2deg((h[:, 2] / h.norm(dim=-1)).acos())
    raan = torch.rad2deg(torch.atan2(node[:, 1], node[:, 0])) % 360
    across = torch.linalg.cross(h, node)
    argument = torch.atan2((e * across).sum(-1) / across.norm(dim=-1), (e * node).sum(-1) / node.norm(dim=-1))
    return r.norm(dim=-1), e.norm(dim=-1), inclination, raan, torch.rad2deg(argument) % 360


@pytest.mark.parametrize("mass", [1.0, 3.0])
def test_orbits_have_the_elements_asked_for(mass):
    system = dataclasses.replace(WIDE, mass=mass)
    x = system.initial_states(2000, generator(5))
    x[:, 3:] /= mass
    periapsis, e, i, raan, argument = elements(x, system.mu)
    ranges = (
        (periapsis - system.r_eq, system.altitude),
        (e, system.eccentricity),
        (i, system.inclination),
        (raan, system.raan),
        (argument, system.argument_of_periapsis),
    )
    for values, (low, high) in ranges:
        width = high - low
        assert float(values.min()) >= low - 1e-9 * max(1, high)
        assert float(values.max()) <= high + 1e-9 * max(1, high)
        assert float(values.min()) < low + 0.01 * width
        assert float(values.max()) > high - 0.01 * width
        assert abs(float(values.mean()) - (low + high) / 2) < 0.03 * width


def test_orbits_start_at_periapsis():
    q, p = WIDE.initial_states(100, generator(1)).chunk(2, dim=-1)
    assert float(((q * p).sum(-1) / (q.norm(dim=-1) * p.norm(dim=-1))).abs().max()) < 1e-15


def test_the_default_orbit_has_its_periapsis_in_the_south():
    system = dataclasses.replace(MOLNIYA, inclination=(63.4, 63.4), altitude=(550.0, 550.0))
    x = system.initial_states(1, generator(0))[0]
    radius, i = system.r_eq + 550.0, math.radians(63.4)
    expected = torch.tensor([0.0, -radius * math.cos(i), -radius * math.sin(i)], dtype=torch.float64)
    assert float((x[:3] - expected).abs().max()) < 1e-9
    assert x[3] > 0


def test_kepler_orbits_have_semi_major_axis_one():
    system = SYSTEMS["kepler"]
    x = system.initial_states(100, generator(2))
    assert float((system.energy(x) + 0.5).abs().max()) < 1e-14


def test_the_spring_starts_in_its_rectangle():
    system = dataclasses.replace(SPRING, q0=(0.2, 0.3), p0=[-0.5, -0.4])
    q, p = system.initial_states(500, generator(3)).unbind(-1)
    assert 0.2 <= float(q.min()) < float(q.max()) <= 0.3
    assert -0.5 <= float(p.min()) < float(p.max()) <= -0.4


@pytest.mark.parametrize(
    ("system", "change"),
    [
        (MOLNIYA, {"altitude": (560.0, 540.0)}),
        (MOLNIYA, {"eccentricity": (0.8, 0.7)}),
        (MOLNIYA, {"inclination": (66.0, 60.0, 61.0)}),
        (SPRING, {"q0": [1.0, -1.0]}),
        (SPRING, {"p0": [math.nan, 1.0]}),
        (SYSTEMS["pendulum"], {"q0": (2.0, -2.0)}),
        (SYSTEMS["kepler"], {"eccentricity": (0.5, 0.0)}),
        (SYSTEMS["henon_heiles"], {"amplitude": (0.2, -0.2)}),
    ],
)
def test_a_range_that_is_none_is_refused_by_name(system, change):
    with pytest.raises(UserError, match=next(iter(change))):
        dataclasses.replace(system, **change).initial_states(3, generator(0))
