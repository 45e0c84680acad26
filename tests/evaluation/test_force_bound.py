"""The bound of the true force: an oscillator in closed form, repeated experiments, and what a row says."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import KEPLER, SPRING, make_case, trajectories
from helpers import MOLNIYA, close, generator
from torch import nn

from ahnn.data.generate import generate
from ahnn.data.sensor import Sensor
from ahnn.dynamics import make_dynamics
from ahnn.evaluation import evaluate
from ahnn.evaluation.force_bound import (
    TRAJECTORIES,
    chosen,
    force_bound,
    information,
    information_of,
    unknown_constants,
)
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Segment
from ahnn.rollouts import rollout
from ahnn.systems import MassSpring

DOUBLE = {"dtype": torch.float64}
SPRING = dataclasses.replace(SPRING, dt=0.04, steps=30)
SYSTEM = MassSpring(name="spring", dt=0.05, steps=40, mass=2.0, stiffness=3.0)


def measured(system, data, every=1, **options):
    sensor = Sensor(system.space, **{"measured": "position", "noise": 0.01, "every": every, **options})
    return Segment(*sensor.measure(data, 0), sensor.instrument(system.dt))


def swing(stiffness, start, times, mass=2.0):
    """Positions (..., T) of a spring and their derivatives with respect to k, q0 and p0, (..., T, 3)."""
    rate = (stiffness / mass) ** 0.5
    q, p = start[..., :1], start[..., 1:]
    c, s = (rate * times).cos(), (rate * times).sin()
    of_rate = -q * times * s + p / mass * (times * c / rate - s / rate**2)
    of_start = torch.stack((c.expand_as(of_rate), (s / (mass * rate)).expand_as(of_rate)), dim=-1)
    slopes = torch.cat(((of_rate * rate / (2 * stiffness)).unsqueeze(-1), of_start), dim=-1)
    return q * c + p / (mass * rate) * s, slopes


def test_the_information_is_that_of_the_oscillator_in_closed_form():
    data = trajectories(SYSTEM, 4, 0)
    segment = measured(SYSTEM, data, every=2, gaps=0.2)
    start = data.states[:, 0]
    _, slopes = swing(torch.tensor(3.0, **DOUBLE), start, segment.times[0])
    rows = slopes / 0.01 * segment.values.isfinite()
    whole = torch.zeros(9, 9, **DOUBLE)  # k and four starts
    for b, own in enumerate(rows):
        place = torch.tensor([0, 1 + 2 * b, 2 + 2 * b])
        whole[place.unsqueeze(1), place] += own.mT @ own
    deviation = torch.linalg.inv(whole)[0, 0].sqrt()
    found = information_of(SYSTEM, ["stiffness"], start, segment)
    close(found.rsqrt().squeeze(), deviation / 3.0, 1e-5)


def test_starts_are_eliminated_as_the_inverse_of_the_whole_matrix_does():
    of_constants, of_start = (torch.randn(1, 30, k, generator=generator(k), **DOUBLE) for k in (3, 4))
    whole = torch.cat((of_constants, of_start), -1)[0]
    block = torch.linalg.inv(whole.mT @ whole)[:3, :3]
    close(torch.linalg.inv(information(of_constants, of_start)), block, 1e-9)
    twice = torch.cat((of_start, of_start[..., :1]), -1)  # a start that is not determined
    close(information(of_constants, twice), information(of_constants, of_start), 1e-9)


def test_the_bound_is_the_spread_of_repeated_experiments():
    """Gauss-Newton on k and the starts of 3 trajectories, 2,000 times with other noise."""
    data, repeats, sd = trajectories(SYSTEM, 3, 0), 2000, 0.02
    segment = measured(SYSTEM, data, noise=sd)
    start, times = data.states[:, 0], data.times[0]
    exact = swing(torch.tensor(3.0, **DOUBLE), start, times)[0]
    noise = torch.randn(repeats, *exact.shape, generator=generator(5), **DOUBLE)
    k, x = torch.full((repeats, 1, 1), 3.0, **DOUBLE), start.repeat(repeats, 1, 1)
    for _ in range(4):
        positions, slopes = swing(k, x, times)
        design = torch.zeros(repeats, 3, len(times), 7, **DOUBLE)
        design[..., 0] = slopes[..., 0]
        for b in range(3):
            design[:, b, :, 1 + 2 * b : 3 + 2 * b] = slopes[:, b, :, 1:]
        left = (exact + sd * noise - positions).flatten(1).unsqueeze(-1)
        move = torch.linalg.lstsq(design.flatten(1, 2), left).solution.squeeze(-1)
        k, x = k + move[:, :1, None], x + move[:, 1:].unflatten(1, (3, 2))
    found = information_of(SYSTEM, ["stiffness"], start, segment)
    close(found.rsqrt().squeeze(), (k / 3.0).std(), 0.05)  # 1.6 % of it is chance


def test_two_constants_of_orbits_are_those_of_differences_of_exact_flows():
    data = generate(dataclasses.replace(MOLNIYA, steps=120), 2, 0)
    segment = measured(MOLNIYA, data, every=5, noise=0.1)
    found = information_of(MOLNIYA, ["mu", "j2"], data.states[:, 0], segment)
    assert found.shape == (2, 2)
    stiff = dataclasses.replace(MOLNIYA, mu=MOLNIYA.mu * (1 + 1e-5))
    moved = rollout(Integrated(stiff, INTEGRATORS["kahan_li8"]), data.states[:, 0], 60.0, 121)
    change = ((moved - data.states)[:, ::5, :3] / 1e-5 / 0.1).square().sum()
    alone = information_of(MOLNIYA, ["mu"], data.states[:, 0], segment)
    close(found[:1, :1], alone, 1e-6)
    assert float(alone) < float(change)  # what starts explain is lost


def case_of(tmp_path, stiffness=5.01):
    data = trajectories(SPRING, 100, 3)
    return make_case(
        tmp_path,
        wrong=dataclasses.replace(SPRING, stiffness=stiffness),
        train=data,
        learned_from=measured(SPRING, data, measured="state", noise=1e-3),
        measured=measured(SPRING, trajectories(SPRING, 3, 1), measured="state", noise=1e-3),
    )


def known(system, names=("stiffness",)):
    return lambda *_: tuple(name for name in names if hasattr(system, name))


def test_a_stiffness_that_is_off_is_as_many_bounds_off(tmp_path, monkeypatch):
    """One constant: to first order every error is the same multiple of its bound."""
    monkeypatch.setattr("ahnn.evaluation.force_bound.unknown_constants", known(SPRING))
    case = case_of(tmp_path)
    prediction = rollout(case.flow, case.test.states[:, 0], case.dt, case.test.states.shape[1])
    found = force_bound(case, prediction)
    assert found is not None
    expected = 0.01 / 5.0 / found.deviations[0]
    assert found.efficiency == pytest.approx((expected, expected), rel=0.01)
    few = information_of(SPRING, ["stiffness"], case.train.states[:, 0], case.learned_from)
    assert found.deviations[0] == pytest.approx(float(few.rsqrt()), rel=0.05)  # 64 stand for 100
    assert len(chosen(100)) == TRAJECTORIES


def test_the_mass_is_unknown_where_velocities_are_learned():
    options = {"dof": 3, "inertia": 1.0, "mu": None, "inputs": "cartesian", "scaling": "block"}
    options |= {"network": {"width": 4, "depth": 1, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    of = {
        kind: make_dynamics("hamiltonian", hamiltonian=kind, **options) for kind in ("generic", "mechanical")
    }
    assert unknown_constants(MOLNIYA, of["mechanical"]) == ("mu", "j2")
    assert unknown_constants(MOLNIYA, of["generic"]) == ("mu", "j2", "mass")
    assert unknown_constants(dataclasses.replace(MOLNIYA, j2=0.0), of["mechanical"]) == ("mu",)
    assert unknown_constants(KEPLER, of["generic"]) == ()


def test_a_row_says_the_bound_where_it_is_known(tmp_path):
    case = dataclasses.replace(case_of(tmp_path), flow=Learned())
    row = evaluate(case, {}, figures=False).rows[0]
    assert "times the bound for the true force with unknown stiffness, mass and initial states" in row.note
    assert row.extra["force_bound"]["constants"] == ["stiffness", "mass"]
    assert row.extra["force_bound"]["efficiency"][0] > 1
    without = evaluate(dataclasses.replace(case, learned_from=None), {}, figures=False).rows[0]
    assert "bound" not in without.note
    assert "force_bound" not in without.extra


class Learned(nn.Module):
    """A spring with another stiffness by RK4, as a module."""

    field = None

    def increment(self, x, dt):
        wrong = dataclasses.replace(SPRING, stiffness=5.01)
        return INTEGRATORS["rk4"].step(wrong, x, dt) - x

    def forward(self, x, dt):
        return x + self.increment(x, dt)
