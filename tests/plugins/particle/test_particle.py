"""The particle filter: the Kalman and the grid filter where they are exact, weights that survive anything."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import torch
from sample_filters import (
    F64,
    NAN,
    P0,
    H,
    Linear,
    R,
    Square,
    draw,
    grid_filter,
    growth,
    kalman,
    linear_problem,
    same,
    spring_nees,
    steps_of,
)

from ahnn.estimation import Gate, Status, initial_belief, load_state, save_state
from ahnn.estimation.consistency import band
from ahnn.measurements import Position
from ahnn_plugins.particle import ParticleFilter
from ahnn_plugins.particle.weighing import exponent

FEW = ParticleFilter(particles=60)


@pytest.mark.parametrize("options", [{}, {"stages": 1, "bandwidth": 0.0}], ids=["stages", "bootstrap"])
def test_on_a_linear_system_it_is_the_kalman_filter_but_for_what_it_draws(options):
    q = 0.1
    problem = linear_problem(q, steps=12)
    means, covariances, likelihoods = kalman(q, problem[2], problem[1].mean)
    sd = covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = sd.unsqueeze(-1) * sd.unsqueeze(-2)
    result = ParticleFilter(particles=8_000, **options).run(*problem)
    assert not bool(result.status.any())
    assert float(((result.means - means) / sd).square().mean().sqrt()) < 0.1
    assert float(((result.covariances - covariances) / scale).square().mean().sqrt()) < 0.12
    assert float((result.log_likelihood - likelihoods).abs().max()) < 0.35


@pytest.mark.parametrize(
    "options", [{"stages": 1, "bandwidth": 0.0}, {"bandwidth": 0.02}], ids=["bootstrap", "stages"]
)
def test_it_keeps_both_modes_that_a_grid_filter_finds(options):
    """The growth model of Gordon et al. without its forcing: squares tell no sign."""
    q, r = 4.0, 1.0
    x, rows = torch.tensor([[0.5]], dtype=F64), []
    for k in range(15):
        x = growth(x, 1.0) + q**0.5 * draw(1, 1, seed=k)
        rows.append(float(Square()(x, 0)) + float(draw(1, seed=50 + k)))
    means, variances, told = grid_filter(rows, q, r)
    assert np.sum(variances > 16) > 5  # two modes, several deviations apart
    pf = ParticleFilter(particles=10_000, **options)
    measured = torch.tensor(rows, dtype=F64)[None, :, None]
    result = pf.run(growth, initial_belief([[0.1]], [[2.0]]), measured, Square(), [[q]], [[r]], 1.0)
    assert result.status.tolist() == [0]
    deviation = np.sqrt(variances)
    np.testing.assert_allclose(result.means[0, :, 0].numpy() / deviation, means / deviation, atol=0.15)
    np.testing.assert_allclose(result.covariances[0, :, 0, 0], variances, rtol=0.15)
    assert float(result.log_likelihood) == pytest.approx(told, abs=0.3)


@pytest.mark.parametrize("stages", [1, 50])
def test_weights_survive_a_measurement_a_hundred_deviations_off(stages):
    pf = ParticleFilter(particles=500, stages=stages)
    state = pf.start(initial_belief([[0.0, 0.0]], np.eye(2)))
    after, told = pf.update(state, [[100.0]], Position(1), [[1.0]])
    assert after.status.tolist() == [Status.OK]
    assert bool(after.points.isfinite().all())
    assert float(after.log_weights.exp().sum()) == pytest.approx(1.0)
    assert float(told.log_likelihood) < -1000
    # In stages particles go beyond where they were, and only as far as their tails let them.
    assert (float(after.belief.mean[0, 0]) > 4) == (stages > 1)


@pytest.mark.parametrize("ratio", [1e-2, 1e-4, 1e-6])
def test_a_measurement_far_more_precise_than_the_belief_is_taken_in_stages(ratio):
    """Position is measured, and its momentum known through a correlation; without stages nothing is left."""
    p0 = np.array([[1.0, 0.8], [0.8, 1.0]])
    start, y = initial_belief(torch.zeros(4, 2), p0), torch.tensor([[-1.0], [0.3], [1.0], [2.0]], dtype=F64)
    staged, at_once = (ParticleFilter(particles=5000, stages=n) for n in (50, 1))
    after, told = staged.update(staged.start(start), y, Position(1), [[ratio**2]])
    assert not bool(after.status.any())
    mean, sd = after.belief.mean, after.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    assert float((mean[:, 0] - y[:, 0]).abs().max()) < ratio
    torch.testing.assert_close(sd[:, 0] / ratio, torch.ones(4, dtype=F64), atol=0.25, rtol=0)
    torch.testing.assert_close(mean[:, 1], 0.8 * y[:, 0], atol=0.3, rtol=0)
    torch.testing.assert_close(sd[:, 1], torch.full((4,), 0.6, dtype=F64), atol=0.12, rtol=0)
    law = torch.distributions.Normal(0.0, 1.0).log_prob(y[:, 0])
    torch.testing.assert_close(told.log_likelihood, law, atol=0.35, rtol=0)
    gone, _ = at_once.update(at_once.start(start), y, Position(1), [[ratio**2]])
    assert bool(gone.status.any()) == (ratio < 1e-3)


def test_a_measurement_ten_deviations_off_is_met_where_no_particle_was():
    """By stages: the exact belief is N(5, 1/2)."""
    pf, count = ParticleFilter(particles=1000), 20
    state = pf.start(initial_belief([[0.0, 0.0]] * count, np.eye(2)))
    after, told = pf.update(state, [[10.0]] * count, Position(1), [[1.0]])
    exact = -25.0 - 0.5 * math.log(4 * math.pi)
    assert float(told.log_likelihood.mean()) == pytest.approx(exact, abs=0.6)
    assert float(after.belief.mean[:, 0].mean()) == pytest.approx(5.0, abs=0.25)
    assert 0.85 < float(after.belief.covariance[:, 0, 0].mean() / 0.5) < 1.1


def test_an_exponent_leaves_just_enough_particles():
    weights = torch.full((3, 400), -math.log(400), dtype=F64)
    densities = torch.stack([-0.5 * scale * draw(400).square() for scale in (1e-3, 50.0, 1e7)])
    power = exponent(weights, densities, torch.tensor([1.0, 1.0, 0.5], dtype=F64), 200.0, 300.0)
    w = torch.softmax(power.unsqueeze(-1) * densities, -1)
    sizes = 1 / w.square().sum(-1)
    assert float(power[0]) == 1.0
    assert sizes[0] > 390
    assert bool(((sizes[1:] >= 300.0) & (sizes[1:] < 301.0)).all())


def test_a_kernel_keeps_mean_and_covariance():
    pf = ParticleFilter(particles=50_000, bandwidth=0.7)
    belief = initial_belief([[1.0, -2.0]], [[1.0, 0.6], [0.6, 2.0]])
    state = pf.start(belief)
    h = pf.kernel_bandwidth(2, torch.tensor([True]))
    moved = pf.resampled(state._replace(updates=state.updates + 1), torch.tensor([True]), h, 0)
    assert not torch.equal(moved.points, state.points)
    torch.testing.assert_close(moved.points.mean(1), belief.mean, atol=0.03, rtol=0)
    torch.testing.assert_close(moved.points[0].mT.cov(), belief.covariance[0], atol=0.04, rtol=0)
    best = ParticleFilter(particles=1000).kernel_bandwidth(2, torch.tensor([True, False])).tolist()
    assert best == pytest.approx([0.6, (1 / 1000) ** (1 / 6)])


def test_particles_are_resampled_only_below_the_threshold():
    pf = ParticleFilter(particles=200, resample_below=0.5, stages=1, bandwidth=0.0)
    state = pf.start(initial_belief([[0.0, 0.0]] * 2, np.eye(2)))
    after, _ = pf.update(state, [[0.0], [1.0]], Position(1), [[[1e4]], [[1e-2]]])
    assert torch.equal(after.points[0], state.points[0])
    assert not torch.equal(after.log_weights[0], state.log_weights[0])
    assert len(after.points[1].unique(dim=0)) < 100
    assert torch.equal(after.log_weights[1], state.log_weights[1])


def test_particles_without_a_number_count_nothing_and_a_member_without_particles_is_lost():
    flow, belief, rows, *rest = linear_problem(0.1, steps=6)

    def broken(which):
        def flow_of(x, dt):
            return torch.where(which(torch.arange(len(x)))[:, None], torch.nan, flow(x, dt))

        return flow_of

    half = FEW.run(broken(lambda k: (k >= 60) & (k < 90)), belief, rows, *rest)  # of member 1
    assert half.status.tolist() == [Status.OK, Status.OK]
    assert bool(half.state.log_weights[1, :30].isneginf().all()) or bool(half.means.isfinite().all())
    whole = FEW.run(broken(lambda k: k >= 60), belief, rows, *rest)
    assert whole.status.tolist() == [Status.OK, Status.NOT_FINITE]
    alone = FEW.run(flow, type(belief)(*(part[:1] for part in belief)), rows[:1], *rest)
    for other in (half, whole):
        torch.testing.assert_close(other.means[:1], alone.means, rtol=1e-12, atol=1e-13)

    class Blind(Linear):
        def __call__(self, x, t):
            return torch.where(x[..., :1] > 0, super().__call__(x, t), torch.nan)

    state = FEW.start(initial_belief(torch.zeros(2, 3), P0))
    after, told = FEW.update(state, torch.tensor([[1.0, 0.0], [NAN, NAN]], dtype=F64), Blind(), R)
    assert after.status.tolist() == [0, 0]
    assert bool((after.points[0, :, 0] > -0.5).all())
    assert float(told.log_likelihood[1]) == 0.0
    assert torch.equal(after.points[1], state.points[1])


def test_steps_are_the_run_and_a_restored_state_goes_on_bit_for_bit(tmp_path):
    flow, belief, rows, *rest = linear_problem(0.1, steps=12)
    whole, begin = FEW.run(flow, belief, rows, *rest), FEW.start(belief)
    for k, state in enumerate(steps_of(FEW, begin, flow, rows, *rest)):
        if k in (4, 7):
            save_state(state, tmp_path / "a.state")
            kept = load_state(tmp_path / "a.state", like=begin)
            assert same(kept, state)
            assert same(FEW.run(flow, kept, rows[:, k + 1 :], *rest).state, whole.state)
    assert same(state, whole.state)


def test_a_row_with_a_missing_number_is_a_row_of_the_others():
    class First(Linear):
        names, units = ("a",), ("1",)

        def __call__(self, x, t):
            return super().__call__(x, t)[..., :1]

    state = FEW.start(initial_belief(torch.zeros(1, 3), P0))
    short, told = FEW.update(state, [[0.7]], First(), R[:1, :1])
    whole, same_told = FEW.update(state, [[0.7, NAN]], Linear(), R)
    torch.testing.assert_close(short.points, whole.points)
    torch.testing.assert_close(short.log_weights, whole.log_weights)
    torch.testing.assert_close(told.log_likelihood, same_told.log_likelihood)
    torch.testing.assert_close(told.nis, same_told.nis)
    s = float((state.points[0] @ H[0]).var(correction=0) + R[0, 0])
    assert float(told.deviation) == pytest.approx(s**0.5)


def test_it_is_consistent_on_a_spring():
    values, status = spring_nees(ParticleFilter(particles=500), 50)
    assert not bool(status.any())
    low, high = band(2, 50, 0.999)
    assert low < float(values[:, -1].mean()) < high


def test_its_gate_ends_a_member_that_refuses_too_much():
    rows = torch.full((2, 6, 1), 0.5, dtype=F64)
    rows[1, 2:] = 100.0
    belief = initial_belief([[0.5, 0.0]] * 2, 0.01 * np.eye(2))
    options = (Position(1), 1e-8 * np.eye(2), [[1e-2]], 0.1)
    result = FEW.gated(Gate(0.999, 3)).run(lambda x, _: x, belief, rows, *options)
    assert result.status.tolist() == [Status.OK, Status.DIVERGED]
    assert result.failed_step.tolist() == [-1, 4]


WRONG = {
    "particles: expected a whole number >= 2; received 1": {"particles": 1},
    "resample_below: expected a number from 0 to 1; received 2": {"resample_below": 2},
    "bandwidth: expected null or a number in [0, 1); received 1": {"bandwidth": 1},
    "stages: expected a whole number >= 1; received 0": {"stages": 0},
    "seed: expected a whole number from 0": {"seed": 2**63},
}


@pytest.mark.parametrize("message", WRONG)
def test_values_beyond_their_limits_are_refused(message):
    with pytest.raises(ValueError, match=re.escape(message)):
        ParticleFilter(**WRONG[message])
