"""The process noise is the second moment of the residuals that are there, times a factor."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch

from ahnn.estimation import Setting
from ahnn.estimation.process_noise import (
    PAIRS,
    SCALES,
    crossing,
    fitted_process_noise,
    one_step_covariance,
)
from ahnn.estimation.scenario import Problem, simulated
from ahnn.estimation.trial import Filter
from ahnn.measurements import Position
from ahnn.types import Trajectories
from ahnn_plugins.ukf import UnscentedKalmanFilter, UnscentedParameters

F64 = torch.float64
DT = 0.5


def flow(x, dt):
    return x * (1.0 + dt)


def walks(seed: int, count: int = 3, samples: int = 40) -> Trajectories:
    """Trajectories of the flow with a correlated error of nonzero mean in each step."""
    rng = torch.Generator().manual_seed(seed)
    states = [torch.randn(count, 2, generator=rng, dtype=F64)]
    mixing = torch.tensor([[1.0, 0.4], [0.0, 0.3]], dtype=F64)
    for _ in range(samples - 1):
        noise = torch.randn(count, 2, generator=rng, dtype=F64) @ mixing + 0.7
        states.append(-0.6 * states[-1] + noise)
    times = DT * torch.arange(samples, dtype=F64)
    return Trajectories(torch.stack(states, 1), times.expand(count, -1))


def second_moment(data: Trajectories, model=flow):
    """Sum over all pairs that are there, one after the other."""
    total, pairs = torch.zeros(2, 2, dtype=F64), 0
    for states in data.states:
        for before, after in pairwise(states):
            residual = model(before, DT) - after
            if bool(residual.isfinite().all()):
                total, pairs = total + torch.outer(residual, residual), pairs + 1
    return total / max(pairs, 1)


def test_the_moment_is_over_all_pairs_and_keeps_the_mean():
    data = walks(0)
    torch.testing.assert_close(one_step_covariance(flow, data), second_moment(data), rtol=1e-12, atol=0)


def test_pairs_beside_absent_samples_are_left_out():
    data = walks(1)
    data.states[0, 25:] = torch.nan
    data.states[1, 4, 1] = torch.nan
    got = one_step_covariance(flow, data)
    assert bool(got.isfinite().all())
    torch.testing.assert_close(got, second_moment(data), rtol=1e-12, atol=0)


@pytest.mark.parametrize("lost", [math.nan, math.inf])
def test_predictions_that_are_not_finite_are_left_out(lost):
    data = walks(2)

    def broken(x, dt):
        wrong = x[..., :1] > 1.0
        return torch.where(wrong & torch.tensor([False, True]), lost, flow(x, dt))

    got = one_step_covariance(broken, data)
    assert bool(got.isfinite().all())
    torch.testing.assert_close(got, second_moment(data, broken), rtol=1e-12, atol=0)
    assert torch.equal(one_step_covariance(lambda x, _: x * lost, data), torch.zeros(2, 2, dtype=F64))


def test_of_many_pairs_an_even_choice_is_taken():
    seen = []

    def counted(x, dt):
        seen.append(x)
        assert dt == DT
        return flow(x, dt)

    data = walks(3, count=2, samples=PAIRS + 1)
    one_step_covariance(counted, data)
    (chosen,) = seen
    assert len(chosen) == PAIRS
    assert torch.equal(chosen[0], data.states[0, 0])
    assert torch.equal(chosen[-1], data.states[-1, -2])
    one_step_covariance(counted, walks(3, count=2, samples=21))
    assert len(seen[-1]) == 40


def test_crossing_takes_the_last_scale_above_the_target():
    scales = (1.0, 10.0, 100.0, 1000.0)
    assert crossing(scales, [9.0, 2.0, 9.0, 1.0], 3.0) == pytest.approx(100 * 10**0.5, rel=1e-12)
    assert crossing(scales, [9.0, 3.0, 1.0, 1.0], 3.0) == pytest.approx(10.0, rel=1e-12)
    assert crossing(scales, [3.0, 3.0, 1.0, 1.0], 3.0) == 1.0
    assert crossing(scales, [9.0, 9.0, 9.0, 4.0], 3.0) == 1000.0
    assert crossing(scales, [9.0, math.nan, 2.0, 1.0], 3.0) == 100.0


def problem(members: int = 40, samples: int = 60):
    """A walk whose steps have variance 0.04, and a filter that believes in nothing else but them."""
    rng = torch.Generator().manual_seed(7)
    steps = torch.randn(members, samples, 2, generator=rng, dtype=F64) * 0.2
    truth = steps.cumsum(1)
    times = DT * torch.arange(samples, dtype=F64)
    setting = Setting(Position(2, "m"), torch.full((2,), 0.1, dtype=F64), torch.ones(2, dtype=F64), (1, 2, 3))
    setting = setting._replace(updates=tuple(range(5, samples)))
    measured = simulated(setting, truth, DT, seed=1)
    arcs = Problem(truth, truth[:, 0] + 0.5, measured, DT)
    still = Filter("still", lambda x, _: x, torch.eye(2), setting.measurement_noise, UnscentedKalmanFilter())
    return still, setting, arcs, Trajectories(truth, times.expand(members, -1))


def test_independent_residuals_need_no_factor():
    still, setting, arcs, data = problem()
    fitted = fitted_process_noise(still, setting, arcs, data)
    torch.testing.assert_close(fitted.one_step, 0.04 * torch.eye(2, dtype=F64), rtol=0.1, atol=0.002)
    assert fitted.scale == pytest.approx(1.0, rel=0.15)
    assert torch.equal(fitted.covariance, fitted.scale * fitted.one_step)
    assert len(fitted.nees) == len(SCALES) == 6
    assert list(SCALES) == pytest.approx([0.1, 1.0, 10.0, 100.0, 1e3, 1e4])
    assert fitted.nees[0] > 2.0 > fitted.nees[2]
    assert fitted.nees[1] == pytest.approx(2.0, rel=0.1)


def test_lost_members_make_a_scale_infinitely_bad():
    still, setting, arcs, data = problem(members=3)

    def fragile(x, _):
        return torch.where((x.abs() > 40).any(-1, keepdim=True), torch.inf, x)

    fitted = fitted_process_noise(still._replace(flow=fragile), setting, arcs, data)
    assert fitted.nees[-1] == math.inf
    assert fitted.scale == SCALES[-1]
    assert math.isfinite(fitted.nees[0])


def test_a_flow_without_residuals_needs_no_noise():
    still, setting, arcs, _ = problem(members=2)
    constant = Trajectories(torch.ones(2, 5, 2, dtype=F64), DT * torch.arange(5, dtype=F64).expand(2, -1))
    fitted = fitted_process_noise(still, setting, arcs, constant)
    assert (fitted.scale, fitted.nees) == (1.0, ())
    assert torch.equal(fitted.covariance, torch.zeros(2, 2, dtype=F64))


def test_a_single_pair_is_its_own_moment():
    data = walks(5, count=1, samples=2)
    torch.testing.assert_close(one_step_covariance(flow, data), second_moment(data), rtol=1e-12, atol=0)


def test_sigma_points_are_by_default_those_of_the_unscaled_transformation():
    assert tuple(UnscentedParameters()) == (1.0, 2.0, 0.0)
