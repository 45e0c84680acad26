"""Gravity fields agree with 40-digit values and their own derivatives, at the poles too; H is conserved."""

from __future__ import annotations

import csv
import dataclasses
import math

import numpy as np
import pytest
import torch
from entry import FIRST, call
from helpers import close, generator, random_states
from hypothesis import given
from hypothesis import strategies as st

from ahnn.data.store import recipe
from ahnn.errors import UserError
from ahnn.evaluation import Who, load_results
from ahnn.integrators import INTEGRATORS
from ahnn.rollouts import rollout
from ahnn.systems import Molniya, MolniyaGravity
from ahnn.systems.gravity import GravityField, ggm05c
from ahnn.systems.gravity.harmonics import solid_harmonics
from ahnn.systems.truth import exact_flow

EARTH_RATE = 7.292115e-5
# U in km^2/s^2 and acceleration in km/s^2 of GGM05C to degree and order 8, computed with 40 digits.
VALUES = [
    (
        (4000.0, -3000.0, 5000.0),
        56.35844808468670079,
        (-0.0045007676457399696, 0.00337574389394080317, -0.00564086158648490185),
    ),
    (
        (-7000.0, 100.0, -1500.0),
        55.694549123115415692,
        (0.00761048263791679983, -0.000108646956111560809, 0.00163500442069445216),
    ),
    (
        (20000.0, 30000.0, 30000.0),
        8.498170202862218595,
        (-7.72538231503729943e-5, -1.15880775269825196e-4, -1.15887697339828192e-4),
    ),
]
ZONAL = MolniyaGravity(name="zonal", dt=60.0, steps=1440)
ROTATING = MolniyaGravity(name="rotating", dt=60.0, steps=1440, order=8, rotation=EARTH_RATE)
NUMBER = st.floats(-1.0, 1.0)


def double(values):
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(("q", "potential", "acceleration"), VALUES)
def test_the_field_to_degree_8_agrees_with_forty_digit_values(q, potential, acceleration):
    field = ggm05c()
    assert float(field.potential(double(q))) == pytest.approx(-potential, rel=1e-15)
    close(field.attraction(double(q)), double(acceleration), 1e-15)


@given(st.tuples(NUMBER, NUMBER, NUMBER), st.integers(0, 8), st.integers(0, 8), st.booleans())
def test_attraction_is_the_gradient_of_the_potential_at_any_degree_and_place(direction, degree, order, polar):
    field = ggm05c().cut(degree, min(order, degree))
    way = double((0.0, 0.0, math.copysign(1.0, direction[2])) if polar else direction)
    way = way if float(way.norm()) > 1e-3 else double((1.0, 0.0, 0.0))
    q = (7000.0 * way / way.norm()).requires_grad_()
    (gradient,) = torch.autograd.grad(field.potential(q), q)
    close(field.attraction(q), -gradient, 1e-13)


def test_fields_of_any_shape_of_coefficients_have_their_gradient_and_solve_laplaces_equation():
    draws = np.random.default_rng(0)
    for degree, order in ((1, 1), (5, 0), (6, 3), (30, 30)):
        c, s = draws.normal(size=(2, degree + 1, order + 1))
        field = GravityField("drawn", 1.0, 1.0, c, s, "unknown")
        q = double([[0.9, -0.5, 0.7], [0.0, 0.0, 1.3], [0.0, 0.0, -1.3], [1e-9, 0.0, 1.2]]).requires_grad_()
        (gradient,) = torch.autograd.grad(field.potential(q).sum(), q)
        close(field.attraction(q), -gradient, 1e-13)
        for place in q.detach():
            curvature = torch.autograd.functional.jacobian(field.attraction, place)
            assert abs(float(curvature.trace())) <= 1e-12 * float(curvature.norm())


def test_squares_of_the_harmonics_of_a_degree_add_up_at_every_latitude():
    """The addition theorem: their sum is 2 n + 1 on the sphere, whatever the place."""
    latitude = torch.deg2rad(double([0.0, 30.0, 60.0, 89.0, 89.9999, 90.0, -90.0]))
    q = torch.stack((latitude.cos() * math.cos(1.0), latitude.cos() * math.sin(1.0), latitude.sin()), dim=-1)
    degree = 250
    square = solid_harmonics(q, 1.0, degree, degree).abs().square().split([*range(1, degree + 2)], dim=-1)
    sums = torch.stack([part.sum(-1) for part in square], dim=-1)
    close(sums / (2 * torch.arange(degree + 1) + 1), torch.ones_like(sums), 1e-10)


def test_the_constants_are_the_published_ones():
    field = ggm05c()
    assert -math.sqrt(5.0) * field.cosines[2, 0] == pytest.approx(1.0826358191967e-3, rel=1e-13)
    assert -math.sqrt(17.0) * field.cosines[8, 0] == pytest.approx(-2.0400436819182e-7, rel=1e-13)
    free = ggm05c("tide_free")
    assert -math.sqrt(5.0) * free.cosines[2, 0] == pytest.approx(1.0826264880850e-3, rel=1e-13)
    assert (field.tide, free.tide) == ("zero_tide", "tide_free")
    assert field.checksum != free.checksum


def test_j2_alone_is_the_system_with_j2():
    plain = ZONAL.gravity_field
    j2 = Molniya(name="j2", dt=60.0, steps=10, mu=plain.mu, j2=-math.sqrt(5.0) * plain.cosines[2, 0])
    system = dataclasses.replace(ZONAL, degree=2, mass=2.0)
    x = random_states(j2, 20, seed=0)
    close(system.energy(x), dataclasses.replace(j2, mass=2.0).energy(x), 1e-14)
    close(system(x), dataclasses.replace(j2, mass=2.0)(x), 1e-14)


@pytest.mark.parametrize("mass", [1.0, 2.5])
@pytest.mark.parametrize("system", [ZONAL, ROTATING], ids=lambda s: s.name)
def test_the_field_of_the_system_is_hamiltons(system, mass):
    system = dataclasses.replace(system, mass=mass)
    x = random_states(system, 20, seed=1).requires_grad_()
    (gradient,) = torch.autograd.grad(system.energy(x).sum(), x)
    dq, dp = gradient.chunk(2, dim=-1)
    close(system(x), torch.cat((dp, -dq), dim=-1), 1e-13)
    close(system(x.view(4, 5, 6)).view(20, 6), system(x), 1e-15)


def in_inertial_axes(x, t):
    """States in the axes of the planet, turned back by the angle that it has turned until t."""
    cosine, sine = math.cos(EARTH_RATE * t), math.sin(EARTH_RATE * t)
    turn = double([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return (x.unflatten(-1, (2, 3)) @ turn.T).flatten(-2)


def test_zonal_harmonics_give_one_orbit_in_both_axes():
    turning = dataclasses.replace(ZONAL, rotation=EARTH_RATE)
    x = ZONAL.initial_states(3, generator(0))
    inertial, fixed = (rollout(exact_flow(system), x, 60.0, 61)[:, -1] for system in (ZONAL, turning))
    close(in_inertial_axes(fixed, 3600.0), inertial, 1e-12)
    assert float((fixed - inertial)[:, :3].norm(dim=-1).min()) > 1000.0


@pytest.mark.parametrize("system", [ZONAL, ROTATING], ids=lambda s: s.name)
@pytest.mark.parametrize("hours", [2, pytest.param(24, marks=pytest.mark.slow)])
def test_energy_and_jacobi_constant_are_kept(system, hours):
    x = system.initial_states(2, generator(0))
    energy = system.energy(rollout(exact_flow(system), x, 60.0, 60 * hours + 1))
    assert float((energy / energy[:, :1] - 1).abs().max()) < 1e-12


def test_a_symplectic_composition_refuses_what_it_would_integrate_without_the_rotation():
    x = ROTATING.initial_states(1, generator(0))
    with pytest.raises(UserError, match="leapfrog: expected a separable Hamiltonian"):
        INTEGRATORS["leapfrog"].step(ROTATING, x, 60.0)
    assert INTEGRATORS["leapfrog"].step(ZONAL, x, 60.0).shape == x.shape


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"degree": 9}, "degree: expected 0 to 8 for GGM05C; received 9"),
        ({"degree": 4, "order": 5, "rotation": 1e-5}, "order: expected 0 to 4 for GGM05C; received 5"),
        ({"order": 2}, "rotation: expected the rotation rate of the planet"),
        ({"tide": "mean_tide"}, "tide: expected zero_tide, as in ggm05c; received mean_tide"),
        ({"gravity": "nowhere.gfc"}, "nowhere.gfc: expected a file"),
        (
            {"altitude": (-6400.0, 0.0)},
            "expected orbits above the centre of the body, at -6378.1363 km",
        ),
        ({"rotation": math.nan}, "rotation: expected float"),
    ],
)
def test_a_field_that_is_none_is_refused(change, said):
    with pytest.raises(UserError, match=said.replace("(", r"\(")):
        dataclasses.replace(ZONAL, **change)


def test_the_recipe_of_a_data_set_holds_the_coefficients():
    known = [recipe(system, 5, 0) for system in (ZONAL, dataclasses.replace(ZONAL, tide="tide_free"))]
    assert known[0]["parameters"]["gravity"] != known[1]["parameters"]["gravity"]
    assert recipe(dataclasses.replace(ZONAL), 5, 0) == known[0]


def test_the_coefficients_are_those_that_were_checked(request):
    """The table of the reference, kept beside the tests, digit for digit."""
    rows = (request.path.parents[1] / "fixtures" / "ggm05c_8x8.csv").read_text().splitlines()
    field = ggm05c()
    for row in csv.DictReader(line for line in rows if not line.startswith("#")):
        n, m = int(row["n"]), int(row["m"])
        assert (field.cosines[n, m], field.sines[n, m]) == (float(row["C"]), float(row["S"]))


ONE = [*FIRST, "trainer.max_epochs=1", "loss.balance=0"]


@pytest.mark.parametrize(
    "name", [pytest.param("molniya_gravity", marks=pytest.mark.slow), "molniya_rotating"]
)
def test_the_systems_train_and_are_evaluated_again(name, tmp_path):
    assert call("ahnn.train", *ONE, f"system={name}", f"run={tmp_path}") == 0
    assert call("ahnn.evaluate", f"run={tmp_path}", "name=again") == 0
    again = load_results(tmp_path / "evaluations" / "again")
    assert again.rows == load_results(tmp_path).rows
    assert again.row(Who("exact field, rk4", "true", floor=True)).scores.position < 0.1


def test_a_method_that_no_floor_goes_through_is_refused_before_anything_is_made(tmp_path, capsys):
    options = [
        "system=molniya_rotating",
        "hamiltonian=separable",
        "integrator=leapfrog",
        f"run={tmp_path}/run",
    ]
    assert call("ahnn.train", *ONE, *options) == 2
    assert "leapfrog: expected a separable Hamiltonian" in capsys.readouterr().err


def test_degrees_that_double_precision_does_not_hold_are_refused():
    wide = np.zeros((1902, 2))
    field = GravityField("wide", 1.0, 1.0, wide, wide, "unknown")
    assert field.cut(1900, 0).degree == 1900
    with pytest.raises(UserError, match="degree: expected 0 to 1900 for wide; received 1901"):
        field.cut(1901, 0)
