"""Particles drawn where a measurement puts them: exact, and there where the bootstrap has none left."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from sample_filters import (
    F64,
    P0,
    Linear,
    R,
    Square,
    draw,
    grid_filter,
    growth,
    kalman,
    linear_problem,
    same,
    steps_of,
)

from ahnn.errors import UserError
from ahnn.estimation import Status, initial_belief, load_state, save_state
from ahnn.estimation.samples import effective_size
from ahnn.measurements import Position
from ahnn_plugins.particle import ParticleFilter

UKF = ParticleFilter(particles=2000, proposal="ukf")
BOOTSTRAP = ParticleFilter(particles=2000, stages=1, bandwidth=0.0)
P = np.array([[1.0, 0.8], [0.8, 1.0]])


@pytest.mark.parametrize("ratio", [1.0, 1e-2, 1e-5])
def test_a_precise_measurement_leaves_as_many_particles_as_kernels_are_wide(ratio):
    """Beside the exact belief, where the bootstrap filter has none or a handful of particles."""
    y, r = torch.tensor([[-1.0], [0.3], [1.0], [2.0]], dtype=F64), ratio**2
    start = initial_belief(torch.zeros(4, 2), P)
    after, told = UKF.update(UKF.start(start), y, Position(1), [[r]])
    plain, _ = BOOTSTRAP.update(BOOTSTRAP.start(start), y, Position(1), [[r]])
    assert not bool(after.status.any())
    gain = 1.0 / (1.0 + r)
    mean, sd = after.belief.mean, after.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    first, second = (gain * r) ** 0.5, (1.0 - 0.64 * gain) ** 0.5
    torch.testing.assert_close(
        (mean[:, 0] - gain * y[:, 0]) / first, torch.zeros(4, dtype=F64), atol=0.2, rtol=0
    )
    torch.testing.assert_close(mean[:, 1], 0.8 * gain * y[:, 0], atol=0.12, rtol=0)
    torch.testing.assert_close(sd[:, 0] / first, torch.ones(4, dtype=F64), atol=0.12, rtol=0)
    torch.testing.assert_close(sd[:, 1] / second, torch.ones(4, dtype=F64), atol=0.1, rtol=0)
    law = torch.distributions.Normal(0.0, (1.0 + r) ** 0.5).log_prob(y[:, 0])
    torch.testing.assert_close(told.log_likelihood, law, atol=0.2, rtol=0)
    size = effective_size(after.log_weights)
    assert float(size.min()) > 500
    if ratio < 0.1:
        gone = plain.status != Status.OK
        distinct = torch.tensor([len(points.unique(dim=0)) for points in plain.points])
        assert bool((gone | (distinct < 60)).all())


def test_on_a_linear_system_it_is_the_kalman_filter_but_for_what_it_draws():
    q = 0.1
    problem = linear_problem(q, steps=10)
    means, covariances, likelihoods = kalman(q, problem[2], problem[1].mean)
    sd = covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = sd.unsqueeze(-1) * sd.unsqueeze(-2)
    result = ParticleFilter(particles=8_000, proposal="ukf").run(*problem)
    assert not bool(result.status.any())
    assert float(((result.means - means) / sd).square().mean().sqrt()) < 0.07
    assert float(((result.covariances - covariances) / scale).square().mean().sqrt()) < 0.09
    assert float((result.log_likelihood - likelihoods).abs().max()) < 0.25


def test_both_modes_that_a_grid_filter_finds_are_kept_under_a_precise_sensor():
    q, r = 4.0, 0.05**2
    x, rows = torch.tensor([[0.5]], dtype=F64), []
    for k in range(10):
        x = growth(x, 1.0) + q**0.5 * draw(1, 1, seed=k)
        rows.append(float(Square()(x, 0)) + 0.05 * float(draw(1, seed=50 + k)))
    means, variances, _ = grid_filter(rows, q, r, points=4001)
    assert np.sum(variances > 16) > 2  # two modes
    pf = ParticleFilter(particles=10_000, proposal="ukf", bandwidth=0.03)
    measured = torch.tensor(rows, dtype=F64)[None, :, None]
    result = pf.run(growth, initial_belief([[0.1]], [[2.0]]), measured, Square(), [[q]], [[r]], 1.0)
    assert result.status.tolist() == [0]
    wide = variances > 4.0
    deviation = np.sqrt(variances)
    assert np.abs((result.means[0, :, 0].numpy() - means) / deviation)[wide].max() < 0.2
    np.testing.assert_allclose(result.covariances[0, :, 0, 0].numpy()[wide], variances[wide], rtol=0.2)


def test_a_row_of_nothing_and_a_restored_state_go_on_bit_for_bit(tmp_path):
    few = ParticleFilter(particles=60, proposal="ukf")
    flow, belief, rows, *rest = linear_problem(0.1, steps=8)
    whole, begin = few.run(flow, belief, rows, *rest), few.start(belief)
    for k, state in enumerate(steps_of(few, begin, flow, rows, *rest)):
        if k == 4:
            save_state(state, tmp_path / "a.state")
            kept = load_state(tmp_path / "a.state", like=begin)
            assert same(few.run(flow, kept, rows[:, k + 1 :], *rest).state, whole.state)
    assert same(state, whole.state)
    after, _ = few.update(state, [[math.nan] * 2] * 2, Linear(), R)
    assert torch.equal(after.points, state.points)


def test_particles_without_an_image_count_nothing():
    class Blind(Linear):
        def __call__(self, x, t):
            return torch.where(x[..., :1] > 0, super().__call__(x, t), torch.nan)

    few = ParticleFilter(particles=400, proposal="ukf")
    after, _ = few.update(few.start(initial_belief(torch.zeros(1, 3), P0)), [[1.0, 0.0]], Blind(), R)
    assert after.status.tolist() == [0]
    kept = after.points[0][after.log_weights[0].isfinite()]
    assert bool((kept[:, 0] > 0).all())


def test_what_it_has_not_is_refused():
    with pytest.raises(UserError, match="proposal: expected one of prior, ukf; received 'ekf'"):
        ParticleFilter(proposal="ekf")
    for options in ({"bandwidth": 0.0}, {"stages": 1}):
        with pytest.raises(
            UserError, match="proposal: expected prior where bandwidth is 0 or stages are set"
        ):
            ParticleFilter(proposal="ukf", **options)
