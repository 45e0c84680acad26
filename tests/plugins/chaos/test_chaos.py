"""Lyapunov exponents of motions that have them in closed form, valid times and overlaps by hand."""

from __future__ import annotations

import math

import pytest
import torch
from cases import SPRING, make_case, trajectories
from helpers import close, generator

from ahnn.errors import UserError
from ahnn.evaluation import evaluate
from ahnn.rollouts import rollout
from ahnn.systems import CartPole, HenonHeiles, exact_flow
from ahnn_plugins.chaos import Chaos, horizons, lyapunov_exponents, overlap


def test_the_exponent_of_an_inverted_oscillator_is_its_rate():
    """X' = p, p' = w^2 x grows as exp(w t) along (1, w)."""
    rate, dt = 1.7, 0.05
    cosh, sinh = math.cosh(rate * dt), math.sinh(rate * dt)
    step = torch.tensor([[cosh, sinh / rate], [rate * sinh, cosh]], dtype=torch.float64)
    times = (dt * torch.arange(400.0, dtype=torch.float64)).expand(3, -1)
    states = 1e-3 * torch.randn(3, 400, 2, dtype=torch.float64, generator=generator(0))
    found = lyapunov_exponents(lambda x, _: x @ step.T, states, times, dt, torch.tensor([2.0, 0.5]).double())
    close(found, torch.full((3,), rate, dtype=torch.float64), 0.08)  # what the first turn takes, over 20 s


def test_no_error_of_a_spring_grows_exponentially(tmp_path):
    case = make_case(tmp_path)
    found = Chaos(threshold=0.4, bins=10)(case)
    assert (
        abs(found.numbers["exponent"]) * SPRING.dt * SPRING.steps < 2.0
    )  # a factor of e^2 at most, for good
    assert found.numbers["not_ended"] == 3
    assert found.numbers["horizon"] == [pytest.approx(1.2)] * 3


def test_chaos_is_told_from_order():
    dt, times = 0.5, 0.5 * torch.arange(400.0, dtype=torch.float64).expand(2, -1)
    system = HenonHeiles(name="h", dt=dt, steps=399)

    flow = exact_flow(system)
    start = torch.tensor(
        [[0.0, -0.25, 0.42, 0.0], [0.0, 0.1, 0.1, 0.0]], dtype=torch.float64
    )  # E = 0.13, 0.01
    states = rollout(flow, start, dt, 400)
    chaotic, regular = lyapunov_exponents(flow, states, times, dt, states.std((0, 1))).tolist()
    assert chaotic > 2 * regular
    assert chaotic > 0.03


def test_valid_times_end_where_the_error_passes_the_threshold():
    times = torch.arange(5.0).expand(3, -1)
    truth = torch.zeros(3, 5, 2)
    guess = truth.clone()
    guess[0, 3:] = 1.0
    guess[1, 2] = torch.nan
    found = horizons(guess, truth, times, torch.tensor([1.0, 1.0]), 0.5)
    assert found.times.tolist() == [3.0, 2.0, 4.0]
    assert found.ended.tolist() == [True, True, False]


def test_overlap_is_one_for_the_same_states_and_nothing_for_others():
    truth = torch.randn(50, 20, 2, dtype=torch.float64, generator=generator(1))
    assert overlap(truth.flip(1), truth, 20) == pytest.approx(1.0)
    assert overlap(truth + 100, truth, 20) == 0.0
    half = torch.cat((truth[:25], truth[:25] + 100))
    assert overlap(half, truth, 1) == pytest.approx(0.5)
    assert overlap(torch.full_like(truth, torch.nan), truth, 20) == 0.0


def test_the_sentence_stands_below_the_table(tmp_path):
    system = HenonHeiles(name="h", dt=0.5, steps=200)
    case = make_case(tmp_path, system, None, test=trajectories(system, 3, 1))
    found = evaluate(case, {"chaos": Chaos(threshold=0.4, bins=10)}, figures=False)
    note = found.rows[0].note
    assert "Lyapunov times" in note or "not chaotic" in note
    assert len(found.numbers["chaos"]["horizons"]) == 3


def test_controlled_motion_is_refused():
    space = CartPole(name="c", dt=0.1, steps=5).space
    with pytest.raises(UserError, match=r"plugins\.chaos: expected motion without controls; received u"):
        Chaos(threshold=0.4, bins=10).check(None, space, 5)
