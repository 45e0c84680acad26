"""Verdicts on data: baselines by hand, energy that is lost, and forces of time, each beside data without."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from cases import RK4, SPRING, make_case, trajectories
from helpers import TINY

from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.evaluation import evaluate
from ahnn.evaluation.baselines import linear_prediction, relative_error, worth
from ahnn.evaluation.conservation import conserves, energy_trend, slope, time_test
from ahnn.evaluation.friction_test import friction_test
from ahnn.evaluation.open_loop import Integrated
from ahnn.measurements import Instrument, Segment, reading
from ahnn.rollouts import rollout
from ahnn.systems import Pendulum
from ahnn.types import Trajectories

FREE = Pendulum(name="free", dt=0.05, steps=100)


def driven(friction=0.0, torque=0.0, count=12, seed=0):
    """Exact trajectories with a torque at 2 rad/s and friction, by small steps of the equations."""
    x = FREE.initial_states(count, torch.Generator().manual_seed(seed))
    states, fine = [x], 20
    step = FREE.dt / fine

    def field(t, x):
        q, p = x.unbind(-1)
        return torch.stack((p, -9.81 * q.sin() - friction * p + torque * math.cos(2 * t)), dim=-1)

    for k in range(FREE.steps * fine):
        t = k * step
        a = field(t, x)
        b = field(t + step / 2, x + step / 2 * a)
        x = x + step * field(t + step / 2, x + step / 2 * b)
        if (k + 1) % fine == 0:
            states.append(x)
    times = FREE.dt * torch.arange(FREE.steps + 1, dtype=torch.float64)
    return Trajectories(torch.stack(states, 1), times.expand(count, -1))


def case_of(folder, test, learned=FREE, **changes):
    flow = Integrated(learned, RK4)
    case = make_case(folder, FREE, None, test=test, train=driven(count=4, seed=1), flow=flow)
    return dataclasses.replace(case, **{"energy": learned.energy} | changes)


def test_baselines_are_those_computed_by_hand(tmp_path):
    case = make_case(tmp_path)
    truth = case.test.states
    prediction = rollout(case.flow, truth[:, 0], case.dt, truth.shape[1])
    found = worth(case, prediction)
    spread = (truth - truth.mean((0, 1))).square().mean((0, 1))
    for guess, error in ((prediction, found.model), (truth[:, :1].expand_as(truth), found.persistence)):
        by_hand = ((guess - truth).square().mean(1) / spread).mean(1).sqrt().mean()
        assert error == pytest.approx(float(by_hand), rel=1e-12)
    assert found.linear == pytest.approx(0.0, abs=1e-9)  # a spring is linear
    assert not found.worthless


def test_what_is_not_measured_does_not_count_and_infinity_is_infinite():
    truth = torch.tensor([[[0.0, 1.0], [2.0, torch.nan], [4.0, torch.nan]]])
    guess = torch.tensor([[[0.0, 1.0], [2.0, 7.0], [5.0, 9.0]]])
    assert relative_error(guess, truth) == pytest.approx(math.sqrt((1 / 3) / (8 / 3)))
    assert relative_error(guess.fill_(torch.inf), truth) == math.inf


def test_a_linear_map_takes_controls_and_none_where_steps_differ(tmp_path):
    case = make_case(tmp_path)
    assert linear_prediction(dataclasses.replace(case, dt=torch.ones(3, 120))) is None
    push = torch.randn(2, 121, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    moved = case.train.states.clone()
    for k in range(120):
        moved[:, k + 1] = 0.9 * moved[:, k] + 2 * push[:, k]
    train = Trajectories(moved, case.train.times, push)
    found = linear_prediction(dataclasses.replace(case, train=train, test=train))
    assert found is not None
    assert relative_error(found, moved) < 1e-9


def test_a_model_that_says_no_more_than_the_mean_is_worthless(tmp_path):
    still = make_case(tmp_path, flow=lambda x, _: x)
    told = evaluate(still, {}, figures=False)
    assert "WORTHLESS: relative error" in told.rows[0].note
    assert told.numbers["worth"]["worthless"]
    right = evaluate(make_case(tmp_path, wrong=None), {}, figures=False)
    assert "relative error less than 0.01 % of the spread of the data (persistence" in right.rows[0].note


def test_energy_that_data_lose_is_named_with_its_rate_and_a_remedy(tmp_path):
    trend = energy_trend(case_of(tmp_path, driven(friction=0.05)))
    assert trend is not None
    assert trend.found
    assert trend.rate == pytest.approx(-0.05, rel=0.35)  # about friction over inertia, twice the mean of T
    assert trend.sentence("s").startswith("along the data the learned energy falls by ")
    assert "forces=friction" in trend.sentence("s")
    gained = energy_trend(case_of(tmp_path, driven(friction=-0.05)))
    assert gained is not None
    assert "rises" in gained.sentence("1")


def test_friction_beside_a_worthless_model_is_in_doubt(tmp_path):
    damped, doubt = driven(friction=0.05), "if it remains with a better model: along the data the learned"
    for flow, expected in ((lambda x, _: x, True), (None, False)):
        changes = {"perturbation": None} | ({} if flow is None else {"flow": flow})
        faults = evaluate(case_of(tmp_path, damped, **changes), {}, figures=False).faults
        assert any(one.startswith(doubt) for one in faults) == expected
        assert any("forces=friction" in one for one in faults)


@pytest.mark.parametrize("gravity", [9.81, 9.0])
def test_data_without_friction_have_no_trend_whatever_the_error_of_the_model(tmp_path, gravity):
    trend = energy_trend(case_of(tmp_path, driven(), dataclasses.replace(FREE, gravity=gravity)))
    assert trend is not None
    assert not trend.found
    assert not trend.sentence("s")


def test_an_error_of_the_model_common_to_all_starts_is_no_friction(tmp_path):
    """All swings start at rest: the energy of a wrong model falls on all of them, then rises."""
    q = torch.linspace(0.9, 1.1, 12, dtype=torch.float64)
    x = torch.stack((q, torch.zeros_like(q)), -1)
    path = rollout(Integrated(FREE, RK4), x, FREE.dt, 19)
    times = FREE.dt * torch.arange(19, dtype=torch.float64).expand(12, -1)
    wrong = dataclasses.replace(FREE, gravity=8.0)
    over_all, _ = slope(wrong.energy(path), times)
    assert over_all.mean() ** 2 > 100 * over_all.var() / len(path)
    trend = energy_trend(case_of(tmp_path, Trajectories(path, times), wrong))
    assert trend is not None
    assert not trend.lasting
    assert not trend.sentence("s")


def test_a_model_with_friction_conserves_nothing(tmp_path):
    assert conserves(Integrated(FREE, RK4))
    options = {
        "inertia": 1.0,
        "hamiltonian": "mechanical",
        "mu": None,
        "inputs": "cartesian",
        "scaling": "block",
    }
    parts = {"network": TINY, "integrator": {"name": "rk4"}}
    made = {
        name: HamiltonianDynamics(1, forces={"own": force}, **options, **parts)
        for name, force in (
            ("friction", {"kind": "friction"}),
            ("spring", {"kind": "spring", "stiffness": 2.0}),
        )
    }
    assert conserves(made["spring"])
    assert not conserves(made["friction"])
    assert energy_trend(case_of(tmp_path, driven(friction=0.05), flow=made["friction"])) is None
    assert energy_trend(case_of(tmp_path, driven(friction=0.05), energy=None)) is None


def test_a_force_of_time_is_told_from_friction_and_from_errors_of_the_model(tmp_path):
    found = time_test(case_of(tmp_path, driven(torque=1.0)))
    assert found is not None
    assert found.found
    assert "forces=forcing" in found.sentence()
    for test, learned in ((driven(friction=0.2), FREE), (driven(), dataclasses.replace(FREE, gravity=9.0))):
        none = time_test(case_of(tmp_path, test, learned))
        assert none is not None
        assert not none.found
        assert not none.sentence()


def test_trajectories_that_run_in_step_say_nothing_of_time(tmp_path):
    one = trajectories(SPRING, 1, 0)
    together = Trajectories(one.states.expand(12, -1, -1).clone(), one.times.expand(12, -1))
    assert time_test(make_case(tmp_path, test=together)) is None


def seen(states, noise, draw=0):
    """Measurements of the angles, every fourth sample."""
    angles = states.states[:, ::2, :1]
    off = noise * torch.randn(
        angles.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(draw)
    )
    instrument = Instrument(
        reading("position", FREE.space), torch.tensor([noise], dtype=torch.float64), FREE.dt, 1, 1.0
    )
    return Segment(angles + off, states.times[:, ::2], instrument)


@pytest.mark.parametrize("friction", [0.0, 0.05, 0.2])
def test_measurements_ask_for_the_friction_that_there_is(friction):
    found = friction_test(Integrated(FREE, RK4), seen(driven(friction=friction, count=40), 0.01))
    assert found is not None
    assert abs(found.rate - friction) < 4 * found.error + 0.02 * friction
    assert found.found == (friction > 0)
    assert ("forces=friction" in found.sentence("s")) == (friction > 0)


def test_wrong_gravity_is_no_friction():
    wrong = dataclasses.replace(FREE, gravity=9.5)
    found = friction_test(Integrated(wrong, RK4), seen(driven(count=40), 0.01))
    assert found is not None
    assert not found.found


def test_few_measurements_show_strong_friction():
    """Eight short trajectories, whose sum of slopes alone exceeds its scatter by the root of their number."""
    few = driven(friction=0.3, count=8)
    short = Trajectories(few.states[:, :61], few.times[:, :61])
    found = friction_test(Integrated(FREE, RK4), seen(short, 0.02))
    assert found is not None
    assert found.found
    assert abs(found.rate - 0.3) < 4 * found.error + 0.02
