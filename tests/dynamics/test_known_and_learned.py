"""Known forces under learned ones: bodies of DE421, a force about an axis, and where a training begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import close, generator

from ahnn.clock import Clock, extended
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.forces import Instant, make_force
from ahnn.errors import UserError
from ahnn.systems.gravity import ggm05c

DOUBLE = {"dtype": torch.float64}
SUN = 2.959122082855911e-4
"""Of DE421, au^3/d^2."""
AU = 149597870.6996262
SKY = {"kind": "third_bodies", "center": "sun", "epoch": 2451545.0, "span": [0.0, 100.0], "spacing": 2.0}
SKY |= {"day": 1.0, "length": AU, "own": 0.05}
PLANETS = ["mercury", "venus", "earthmoon", "mars", "jupiter", "saturn", "uranus", "neptune"]


def instant(t, q, v=None):
    t = torch.as_tensor(t, **DOUBLE).unsqueeze(-1)
    return Instant(t, t[..., :0], q, torch.zeros_like(q) if v is None else v)


def ephemeris():
    pytest.importorskip("jplephem", reason="the extra `ephemeris` is needed")
    import de421
    from jplephem.ephem import Ephemeris

    return Ephemeris(de421)


def test_sun_and_planets_move_a_planet_as_the_ephemeris_has_it():
    """Second differences of Mars in DE421; relativity, 1e-8 of the Sun's pull, is left."""
    known, days = ephemeris(), np.arange(20.0, 80.0, 5.0)
    ahead = [
        (known.position("mars", 2451545.0, days + k) - known.position("sun", 2451545.0, days + k)) / AU
        for k in range(-4, 5)
    ]
    weights = [-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560]
    rate = torch.from_numpy(sum(w * a for w, a in zip(weights, ahead, strict=True)).T.copy())
    q = torch.from_numpy(ahead[4].T.copy())
    pull = make_force("sun", 3, 0, {"kind": "central_attraction", "mu": SUN})
    others = make_force("planets", 3, 0, {**SKY, "bodies": PLANETS})
    at = instant(days, q)
    assert float((pull(at) - rate).norm() / rate.norm()) > 1e-5
    close(pull(at) + others(at), rate, 1e-7)


def test_the_moon_pulls_a_satellite_with_the_difference_of_two_attractions():
    """In km and seconds, against positions and masses read here."""
    known = ephemeris()
    options = {**SKY, "bodies": ["sun", "moon"], "center": "earth", "day": 86400.0, "length": 1.0, "own": 0.0}
    force = make_force("bodies", 3, 0, {**options, "span": [0.0, 1e5], "spacing": 3600.0})
    q = 4e4 * torch.randn(5, 3, generator=generator(0), **DOUBLE)
    t = torch.linspace(0, 1e5, 5, **DOUBLE)
    moon = known.position("moon", 2451545.0, t.numpy() / 86400).T
    earth = known.position("earthmoon", 2451545.0, t.numpy() / 86400).T - moon / (1 + known.EMRAT)
    sun = known.position("sun", 2451545.0, t.numpy() / 86400).T - earth
    expected = 0.0
    for body, mu in ((sun, known.GMS), (moon, known.GMB / (1 + known.EMRAT))):
        r, line = torch.from_numpy(body), torch.from_numpy(body) - q
        pulls = line / line.norm(dim=1, keepdim=True) ** 3 - r / r.norm(dim=1, keepdim=True) ** 3
        expected = expected + mu * AU**3 / 86400**2 * pulls
    close(force(instant(t, q)), expected, 1e-7)
    assert bool(force(instant([-4e4, 2e5], q[:2])).isnan().all())
    at, by = (
        instant(t + 1e3, q),
        instant(*(torch.randn(*s, generator=generator(1), **DOUBLE) for s in ((5, 2), (5, 2, 3)))),
    )
    rows = Instant(*(part.unsqueeze(1) for part in at))
    ahead, back = (force(Instant(*(a + h * b for a, b in zip(rows, by, strict=True)))) for h in (10.0, -10.0))
    close(force.variation(at, by), (ahead - back) / 20, 1e-5)


def test_the_pull_of_moving_bodies_varies_with_time_as_its_differences_do():
    """Also within a node interval, where the speed of a cubic is quadratic in time."""
    ephemeris()
    others, half = make_force("planets", 3, 0, {**SKY, "bodies": ["mercury", "venus"]}), 1e-3
    days = torch.tensor([20.3, 41.1, 60.9], **DOUBLE)
    q = torch.tensor([0.5, -0.3, 0.1], **DOUBLE).expand(3, 3)
    nothing = torch.zeros(3, 1, 3, **DOUBLE)
    by = Instant(torch.ones(3, 1, 1, **DOUBLE), nothing[..., :0], nothing, nothing)
    slope = (others(instant(days + half, q)) - others(instant(days - half, q))) / (2 * half)
    close(others.variation(instant(days, q), by).squeeze(1), slope, 1e-6)


@pytest.mark.parametrize(
    "changes",
    [{"bodies": ["ceres"]}, {"bodies": ["sun"]}, {"bodies": []}, {"span": [0.0, 1e6]}, {"span": [1.0, 1.0]}],
)
def test_bodies_and_dates_that_de421_does_not_have_are_refused(changes):
    ephemeris()
    with pytest.raises(UserError, match=r"third_bodies: expected .*received"):
        make_force("planets", 3, 0, {**SKY, "bodies": ["venus"], **changes})


def model(hamiltonian, mu=None, forces=None):
    options = {"dof": 3, "inertia": 1.0, "inputs": "isotropic", "scaling": "none", "mu": mu, "forces": forces}
    options |= {"network": {"width": 6, "depth": 2, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    return make_dynamics("hamiltonian", hamiltonian=hamiltonian, **options).double()


PULL = {"planet": {"kind": "central_attraction", "mu": 2.0}}


@pytest.mark.parametrize(
    ("hamiltonian", "mu", "forces"),
    [
        ("central_body", 2.0, None),
        ("mechanical", None, PULL),
        ("mechanical", None, {**PULL, "rest": {"kind": "network", "sees": ["q", "v"]}}),
        ("mechanical", None, {**PULL, "rest": {"kind": "orbital", "mu": 2.0, "radius": 1.0}}),
    ],
)
def test_a_model_with_known_physics_begins_at_it(hamiltonian, mu, forces):
    made, x = model(hamiltonian, mu, forces), torch.randn(10, 6, generator=generator(3), **DOUBLE)
    assert made.begins_known
    q, p = x.chunk(2, dim=-1)
    two_body = torch.cat((p, -2 * q / q.norm(dim=-1, keepdim=True) ** 3), dim=-1)
    close(made.field(x).detach(), two_body, 1e-14)
    for parameter in made.parameters():
        parameter.data += 0.3
    assert float((made.field(x) - two_body).detach().norm()) > 0.1
    made.silence()
    close(made.field(x).detach(), two_body, 1e-14)


@pytest.mark.parametrize(
    ("hamiltonian", "forces"), [("mechanical", None), ("central_body", None), ("separable", PULL)]
)
def test_a_model_that_learns_all_does_not(hamiltonian, forces):
    made, x = model(hamiltonian, None, forces), torch.randn(10, 6, generator=generator(3), **DOUBLE)
    assert not made.begins_known
    clock = Clock(x[:, :0], x[:, :0])
    assert float(made.field(extended(x, clock)).detach().norm()) > 0


def test_a_force_in_axes_of_an_orbit_sees_its_eccentricity_and_anomaly():
    """On an ellipse in a tilted plane, each coefficient in turn against the axes of its anomaly."""
    mu, e, f = 2.0, 0.6, torch.linspace(0.1, 6.0, 12, **DOUBLE)
    plane = torch.linalg.qr(torch.randn(3, 3, generator=generator(2), **DOUBLE)).Q
    plane = plane * torch.linalg.det(plane).sign()
    radial = torch.stack((f.cos(), f.sin(), 0 * f), -1) @ plane.T
    along = torch.stack((-f.sin(), f.cos(), 0 * f), -1) @ plane.T
    normal = plane[:, 2].expand(12, 3)
    r = (1.3 / (1 + e * f.cos())).unsqueeze(-1)
    speed = (mu / 1.3) ** 0.5
    v = speed * (e * f.sin().unsqueeze(-1) * radial + (1 + e * f.cos()).unsqueeze(-1) * along)
    force = make_force("rest", 3, 0, {"kind": "orbital", "mu": mu, "radius": 0.5, "falloff": 3}).double()
    for row, (i, j) in enumerate(force.powers):
        for column, axis in enumerate((radial, along, normal)):
            force.coefficients.data.zero_()[row, column] = 0.1
            size = 0.1 * mu / r**2 * (0.5 / r) ** 3 * ((e * f.cos()) ** i * (e * f.sin()) ** j).unsqueeze(-1)
            close(force(instant(f, r * radial, v)).detach(), size * axis, 1e-13)


@pytest.mark.parametrize("learned", [True, False])
def test_an_elliptic_equator_is_the_sectorial_part_of_a_field_in_axes_that_turn(learned):
    field = ggm05c("tide_free").cut(2, 2)
    only = np.zeros((3, 3)), np.zeros((3, 3))
    for part, whole in zip(only, (field.cosines, field.sines), strict=True):
        part[2, 2] = whole[2, 2]
    field = replace(field, cosines=only[0], sines=only[1])
    c, s = ((5 / 12) ** 0.5 * float(part[2, 2]) for part in only)
    options = {"kind": "elliptic_equator", "mu": field.mu, "radius": field.radius, "angle": 0.3, "rate": 0.7}
    force = make_force("e", 3, 0, options if learned else {**options, "cosine": c, "sine": s}).double()
    if learned:
        force.harmonics.data.copy_(torch.tensor([c, s], **DOUBLE))
        close(torch.stack([*force.constants().values()]), torch.tensor([c, s], **DOUBLE), 1e-15)
    t, q = torch.arange(4.0, **DOUBLE), 9e3 * torch.randn(4, 3, generator=generator(4), **DOUBLE)
    for k in range(4):
        a = 0.3 + 0.7 * float(t[k])
        turn = torch.tensor([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]], **DOUBLE)
        close(force(instant(t, q))[k].detach(), turn.T @ field.attraction(turn @ q[k]), 1e-11)
    with torch.no_grad():
        force.silence()
    assert bool((force(instant(t, q)) == 0).all()) is learned


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"kind": "orbital", "mu": 1.0, "radius": 1.0}, "orbital: expected three coordinates; received 2"),
        (
            {"kind": "elliptic_equator", "mu": 1.0, "radius": 1.0, "angle": 0.0, "rate": 1.0, "sine": 1e-6},
            "both cosine and sine or neither; received 2, None and 1e-06",
        ),
    ],
)
def test_forces_about_a_planet_refuse_planes_and_halves_of_a_harmonic(options, said):
    with pytest.raises(UserError, match=said):
        make_force("f", 2, 0, options)
