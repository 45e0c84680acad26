"""Textbook physics beside a model: exact for two bodies with J2 in any unit, and absent for other data."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from cases import make_case
from scipy.integrate import solve_ivp

from ahnn.evaluation import evaluate
from ahnn.evaluation.textbook_orbit import (
    OblateEarth,
    oblate_earth,
    remedy,
    textbook_forecasts,
    textbook_row,
)
from ahnn.evaluation.titles import TEXTBOOK
from ahnn.measurements import Instrument, Segment, reading
from ahnn.systems import MassSpring
from ahnn.types import Space, Trajectories, Units

MU, RADIUS, J2 = 398600.4418, 6378.1363, 1.0826e-3
SPRING = MassSpring(name="spring", dt=0.1, steps=10)
KM, METRES = Units("s", "km", "km/s", "J"), Units("min", "m", "m/min", "J")
STARTS = ([7000.0, 0.0, 0.0, 0.0, 5.4, 5.4], [-3000.0, 9000.0, 1500.0, -5.5, -1.5, 1.0])


def space(units=KM, frame="EME2000, EARTH, UTC", mass=1.0):
    names = ("x", "y", "z", "px", "py", "pz")
    return Space("orbit", names, units, mass, frame)


def rate(_, x):
    """Acceleration by the potential of two bodies and J2, in km and s, differentiated by hand."""
    q, r = x[:3], math.dist(x[:3], (0, 0, 0))
    factor = 1.5 * J2 * MU * RADIUS**2 / r**5
    pull = [
        -MU * a / r**3 - factor * a * (k - 5 * q[2] ** 2 / r**2) for a, k in zip(q, (1, 1, 3), strict=True)
    ]
    return [*x[3:], *pull]


@pytest.fixture(scope="module")
def orbits():
    """States (2, 80, 6) of SciPy's DOP853 every 120 s; km and s."""
    times = torch.arange(80, dtype=torch.float64) * 120
    paths = [
        solve_ivp(rate, (0, 9600), x, "DOP853", times.numpy(), rtol=1e-12, atol=1e-9).y.T for x in STARTS
    ]
    return Trajectories(torch.stack([torch.from_numpy(path) for path in paths]), times.expand(2, -1))


class Wrong(OblateEarth):
    """The textbook's flow with a point mass that is too small by 1e-4."""

    def field(self, x):
        return super().field(x) + torch.cat(
            (0 * x[..., :3], 1e-4 * self.mu * x[..., :3] / x[..., :3].norm(dim=-1, keepdim=True) ** 3), -1
        )


def case_of(folder, test, units=KM, frame="EME2000, EARTH, UTC", flow=None, **changes):
    there = space(units, frame)
    case = make_case(folder, SPRING, None, test=test, train=test, flow=flow or Wrong(there))
    dt = float(test.times[0, 1] - test.times[0, 0])
    known = {"space": there, "truth": None, "perturbation": None, "energy": None, "dt": dt}
    return dataclasses.replace(case, **known | changes)


@pytest.mark.parametrize(("units", "length", "time"), [(KM, 1.0, 1.0), (METRES, 1e3, 1 / 60)])
def test_states_of_an_oblate_earth_are_predicted_in_the_units_of_the_data(
    tmp_path, orbits, units, length, time
):
    scale = torch.tensor([length] * 3 + [length / time] * 3, dtype=torch.float64)
    there = Trajectories(orbits.states * scale, orbits.times * time)
    row, found = textbook_row(case_of(tmp_path, there, units))
    assert row.who.process == TEXTBOOK
    assert not row.who.floor
    assert row.scores.position < 1e-6 * length  # km: 1 mm
    assert (found - there.states)[..., 3:].abs().max() < 1e-8 * length / time


def test_momenta_are_mass_times_velocity(orbits):
    light, heavy = OblateEarth(space()), OblateEarth(space(mass=500.0))
    x = orbits.states[:, 0]
    moved = light(x, 120.0)
    momenta = torch.cat((x[:, :3], 500 * x[:, 3:]), -1)
    expected = torch.cat((moved[:, :3], 500 * moved[:, 3:]), -1)
    assert torch.allclose(heavy(momenta, 120.0), expected, rtol=1e-12)


def test_a_less_accurate_model_is_told_of_the_textbook_with_a_remedy(tmp_path, orbits):
    findings = evaluate(case_of(tmp_path, orbits), {}, figures=False)
    assert [row.who.process for row in findings.rows] == ["model", TEXTBOOK]
    (said,) = [fault for fault in findings.faults if TEXTBOOK in fault]
    assert "hamiltonian=mechanical forces=oblate_planet" in said
    assert "textbook_true_start" in findings.arrays
    aware = case_of(tmp_path, orbits, assumes="mechanical Hamiltonian, known oblateness")
    assert remedy(aware, 1.0, 0.5).endswith("train longer")
    exact = evaluate(case_of(tmp_path, orbits, flow=OblateEarth(space())), {}, figures=False)
    assert not [fault for fault in exact.faults if TEXTBOOK in fault]


def test_other_data_have_no_textbook(tmp_path, orbits):
    assert oblate_earth(case_of(tmp_path, orbits, frame="")) is not None  # a satellite by its distance
    for frame in ("EME2000, SUN, TDB", "EME2000, MOON"):
        assert oblate_earth(case_of(tmp_path, orbits, frame=frame)) is None
    assert oblate_earth(case_of(tmp_path, orbits, Units("1", "1", "1", "1"))) is None
    assert oblate_earth(case_of(tmp_path, orbits, truth=SPRING)) is None
    near = Trajectories(orbits.states / 100, orbits.times)
    assert oblate_earth(case_of(tmp_path, near)) is None
    still = Trajectories(orbits.states[:, :1].expand_as(orbits.states), orbits.times)
    assert textbook_row(case_of(tmp_path, still)) is None  # near the Earth, but not in orbit


def test_forecasts_of_measurements_have_the_noise_of_the_measurements(tmp_path, orbits):
    deviation = 0.02
    noise = deviation * torch.randn(2, 80, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    values = orbits.states[..., :3] + noise
    values[0, 70] += 50.0  # one outlier of 50 km
    one = Instrument(
        reading("position", space()), torch.full((3,), deviation, dtype=torch.float64), 120.0, 3, 1.0
    )
    measured = Segment(values, orbits.times, one)
    shown = torch.cat((values, torch.full_like(values, torch.nan)), -1)
    case = case_of(tmp_path, Trajectories(shown, orbits.times), measured=measured, fitted=orbits.states[:, 0])
    beside = textbook_forecasts(case)
    assert 0.8 < beside.textbook < 2
    assert beside.model > 10 * beside.textbook
    assert TEXTBOOK in beside.sentence()
    assert remedy(case, beside.model, beside.textbook)
    assert not remedy(case, beside.textbook, beside.textbook)
