"""Samples as a belief: resampling, effective size, moments, and random numbers that a place determines."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from ahnn.estimation.random_numbers import RandomNumbers
from ahnn.estimation.samples import effective_size, normalised, sample_moments, systematic_resampling

F64 = torch.float64


def draw(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


@given(
    st.lists(st.floats(-800, 0), min_size=1, max_size=60),
    st.floats(0, 1, exclude_max=True),
    st.integers(0, 5),
)
def test_a_sample_is_drawn_as_often_as_its_weight_says(logs, offset, dead):
    weights = normalised(torch.tensor([logs + [-math.inf] * dead], dtype=F64))
    chosen = systematic_resampling(weights, torch.tensor([offset], dtype=F64))
    count = weights.shape[-1]
    drawn, expected = chosen[0].bincount(minlength=count), count * weights[0].exp()
    assert bool((chosen.diff() >= 0).all())
    assert bool((drawn >= (expected - 1e-9).floor()).all())
    assert bool((drawn <= (expected + 1e-9).ceil()).all())
    assert not bool(drawn[len(logs) :].any())


def test_on_average_a_sample_is_drawn_n_times_its_weight():
    weights = normalised(draw(1, 7).expand(400, -1))
    offset = torch.arange(400, dtype=F64) / 400
    chosen = systematic_resampling(weights, offset)
    mean = torch.nn.functional.one_hot(chosen, 7).double().sum((0, 1)) / 400
    torch.testing.assert_close(mean, 7 * weights[0].exp(), atol=1e-2, rtol=0.0)


def test_effective_sizes_are_one_over_the_sum_of_squares():
    weights = normalised(3 * draw(4, 50))
    torch.testing.assert_close(effective_size(weights), 1 / weights.exp().square().sum(-1))
    alone, even = torch.full((1, 9), -math.inf, dtype=F64), torch.zeros(1, 9, dtype=F64)
    alone[0, 3] = 0.0
    assert float(effective_size(alone)) == 1.0
    assert float(effective_size(normalised(even))) == pytest.approx(9)
    assert bool(normalised(torch.full((1, 3), -math.inf, dtype=F64)).isnan().all())


def test_moments_are_those_of_the_law_and_of_the_ensemble():
    points, weights = draw(3, 40, 2), normalised(draw(3, 40, seed=1))
    for b in range(3):
        w, x = weights[b].exp(), points[b]
        belief = sample_moments(points, weights)
        mean = w @ x
        torch.testing.assert_close(belief.mean[b], mean)
        torch.testing.assert_close(belief.covariance[b], ((x - mean) * w[:, None]).mT @ (x - mean))
        torch.testing.assert_close(sample_moments(points).covariance[b], x.mT.cov())
    few = sample_moments(points[:, :1].expand(-1, 1, -1))
    assert not bool(few.chol.any())


def test_random_numbers_are_those_of_their_place_whatever_was_drawn_before():
    like = torch.zeros(1, dtype=F64)
    first = RandomNumbers(5, 3, 1)
    a, b = first.normal(like, 2, 4), first.uniform(like, 3)
    first.normal(like, 100)
    assert torch.equal(RandomNumbers(5, 3, 1).uniform(like, 3), b)
    assert torch.equal(RandomNumbers(5, 3, 1).normal(like, 2, 4), a)
    assert torch.equal(first.normal(like, 5, 4)[:2], a)  # members do not depend on those behind them
    others = [RandomNumbers(*place) for place in ((6, 3, 1), (5, 4, 1), (5, 3, 2), (5, 1, 3))]
    found = [other.normal(like, 2, 4) for other in others] + [first.normal(like, 2, 4, stage=1)]
    assert all(not torch.equal(a, other) for other in found)
    many = first.normal(like, 20_000)
    assert abs(float(many.mean())) < 0.03
    assert abs(float(many.var()) - 1) < 0.04
