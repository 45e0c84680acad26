"""Parameters that make no physics are refused when the system is built, each by its name."""

from __future__ import annotations

import dataclasses
from math import inf, nan

import pytest
from helpers import MOLNIYA, SPRING, SYSTEMS

from ahnn.arguments import type_hints
from ahnn.errors import UserError

PENDULUM, KEPLER, HENON = (SYSTEMS[name] for name in ("pendulum", "kepler", "henon_heiles"))
REFUSED = [
    *((system, "dt", value) for system in (SPRING, MOLNIYA) for value in (0.0, -1.0, nan, inf)),
    *((system, "mass", value) for system in (SPRING, KEPLER) for value in (0.0, -1.0, nan, inf)),
    *((SPRING, "steps", value) for value in (0, -3)),
    *((SPRING, "stiffness", value) for value in (0.0, -5.0, nan, inf)),
    *((SPRING, "q0", value) for value in ([0.0, inf], (nan, 1.0), (1.0,), (0.0, 1.0, 2.0), (1.0, 0.0))),
    (SPRING, "p0", (-inf, 0.0)),
    *((PENDULUM, "length", value) for value in (0.0, -1.0, nan, inf)),
    *((PENDULUM, "gravity", value) for value in (0.0, nan)),
    (PENDULUM, "q0", (0.0, nan)),
    *((KEPLER, "eccentricity", value) for value in ([2.0, 3.0], [1.0, 1.0], (-0.1, 0.5), (0.0, nan))),
    (HENON, "amplitude", (-inf, inf)),
    *((MOLNIYA, "mu", value) for value in (-1.0, 0.0, nan, inf)),
    *((MOLNIYA, "r_eq", value) for value in (0.0, nan)),
    *((MOLNIYA, "j2", value) for value in (nan, inf)),
    *((MOLNIYA, "altitude", value) for value in ([-9000.0, -8000.0], (0.0, inf))),
    *((MOLNIYA, "eccentricity", value) for value in ([1.0, 1.0], (0.7, 1.2), (-0.1, 0.0))),
    *((MOLNIYA, "periods", value) for value in (-1.0, 0.0, nan, inf)),
    *((MOLNIYA, name, (0.0, inf)) for name in ("inclination", "raan", "argument_of_periapsis")),
]


@pytest.mark.parametrize(("system", "name", "value"), REFUSED, ids=lambda v: getattr(v, "name", str(v)))
def test_a_parameter_that_makes_no_physics_is_refused_by_name(system, name, value):
    with pytest.raises(UserError) as refused:
        dataclasses.replace(system, **{name: value})
    message = str(refused.value)
    assert message.startswith(f"{name}: expected ")
    assert message.endswith(f"received {value}")


def test_the_message_says_what_was_expected():
    for name, value, expected in (
        ("altitude", [-9000, -8000], "orbits above the centre of the body, at -6378.1363 km"),
        ("eccentricity", [0.2, 0.1], "a range [low, high] of numbers >= 0 and < 1, with low <= high"),
        ("j2", inf, "float (finite)"),
    ):
        with pytest.raises(UserError) as refused:
            dataclasses.replace(MOLNIYA, **{name: value})
        assert str(refused.value) == f"{name}: expected {expected}; received {value}"


@pytest.mark.parametrize(
    ("system", "change"),
    [
        (MOLNIYA, {"j2": 0.0}),
        (MOLNIYA, {"j2": -1e-3}),
        (MOLNIYA, {"altitude": (-100.0, 0.0)}),
        (MOLNIYA, {"eccentricity": (0.0, 0.999)}),
        (MOLNIYA, {"periods": 0.5}),
        (SPRING, {"q0": (0.5, 0.5)}),
        (SPRING, {"stiffness": 3}),
        (KEPLER, {"eccentricity": (0.0, 0.0)}),
    ],
)
def test_what_is_unusual_but_possible_passes(system, change):
    assert dataclasses.replace(system, **change) != system


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_parameter_has_a_limit(name):
    hints = type_hints(type(SYSTEMS[name]))
    for field in dataclasses.fields(SYSTEMS[name]):
        assert field.name == "name" or "Within(" in repr(hints[field.name])
