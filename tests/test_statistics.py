"""Statistics of trajectories against naive loops over their neighbouring samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from helpers import close, generator

from ahnn.statistics import Statistics, increments_of, sampling_interval
from ahnn.types import Trajectories


def sampled(seed, *, uniform, count=4, samples=30, dof=2):
    """Random trajectories with a few samples absent."""
    rng = generator(seed)
    states = torch.randn(count, samples, 2 * dof, generator=rng, dtype=torch.float64).cumsum(1) + 3.0
    steps = torch.full((count, samples), 0.2, dtype=torch.float64)
    if not uniform:
        steps = steps + torch.rand(steps.shape, generator=rng, dtype=torch.float64)
    states[1, 20:], states[2, 7, 1] = torch.nan, torch.nan
    return Trajectories(states, 10 + steps.cumsum(1))


def pairs(data):
    """Neighbouring samples that are both there: states before and after, and the time between."""
    states, times = data.states.numpy(), data.times.numpy()
    rows = [
        (states[b, k], states[b, k + 1], times[b, k + 1] - times[b, k])
        for b in range(states.shape[0])
        for k in range(states.shape[1] - 1)
        if np.isfinite(states[b, k : k + 2]).all()
    ]
    return (torch.from_numpy(np.stack([row[i] for row in rows])) for i in range(3))


@pytest.mark.parametrize("uniform", [True, False])
def test_statistics_are_those_of_neighbouring_samples(uniform):
    data = sampled(0, uniform=uniform)
    before, after, steps = pairs(data)
    moved = after - before
    rates = moved / steps.unsqueeze(-1)
    got = Statistics.of(data)
    close(got.increment, moved.square().mean(0).sqrt(), 1e-13)
    close(got.rate, rates.square().mean(0).sqrt(), 1e-12)
    close(got.positions, ((before + after) / 2)[:, :2], 1e-13)
    close(got.forces, rates[:, 2:], 1e-11)
    assert got.dt == pytest.approx(0.2 if uniform else float(steps.median()), rel=1e-12)
    there = data.states[data.present]
    close(got.minimum, there.amin(0), 0.0)
    close(got.maximum, there.amax(0), 0.0)
    distance = there[:, :2].square().sum(-1).sqrt()
    close(got.radius, torch.stack((distance.min(), distance.max())), 1e-14)


@pytest.mark.parametrize("uniform", [True, False])
def test_times_that_all_share_are_the_times_of_each(uniform):
    own = sampled(0, uniform=uniform)
    controls = torch.randn(4, 30, 1, generator=generator(3), dtype=torch.float64)
    shared = own._replace(times=own.times[0], controls=controls)
    own = shared._replace(times=own.times[:1].repeat(4, 1))
    for got, expected in zip(Statistics.of(shared), Statistics.of(own), strict=True):
        assert got is expected or torch.equal(torch.as_tensor(got), torch.as_tensor(expected))


@pytest.mark.parametrize("uniform", [True, False])
def test_examples_are_evenly_thinned_and_all_else_is_of_all_samples(uniform):
    data = sampled(1, uniform=uniform)
    whole, some = Statistics.of(data), Statistics.of(data, examples=20)
    every = len(whole.positions) // 20
    assert every > 2
    close(some.positions, whole.positions[::every], 0.0)
    close(some.forces, whole.forces[::every], 1e-15)
    for name in ("minimum", "maximum", "increment", "rate", "radius"):
        assert torch.equal(getattr(some, name), getattr(whole, name))
    assert torch.equal(Statistics.of(data, examples=1000).positions, whole.positions)


def test_no_more_than_20_000_examples_are_kept_unless_asked_for():
    states = torch.arange(120_004.0, dtype=torch.float64).reshape(2, -1, 2)
    times = torch.arange(states.shape[1], dtype=torch.float64).expand(2, -1)
    assert len(Statistics.of(Trajectories(states, times)).positions) == 20_000


def test_increments_are_absent_beside_an_absent_sample():
    states = torch.tensor([[[1.0, 2.0], [4.0, math.nan], [5.0, 5.0], [9.0, 4.0]]], dtype=torch.float64)
    steps = increments_of(Trajectories(states, torch.arange(4.0).double().unsqueeze(0)))
    assert steps.shape == (1, 3, 2)
    assert steps[0, 2].tolist() == [4.0, -1.0]
    assert not bool(steps[0, :2].isfinite().all(-1).any())


def interval(*times):
    rows = torch.tensor(times, dtype=torch.float64)
    return sampling_interval(Trajectories(torch.zeros(*rows.shape, 2), rows))


def test_the_sampling_interval_is_one_number_up_to_rounding():
    assert interval([5.0, 5.5, 6.0], [1.0, 1.5, 2.0]) == 0.5
    assert interval([0.0, 0.5, 1.0 + 1e-10]) == 0.5
    grid = 1e9 + 0.1 * torch.arange(50, dtype=torch.float64)  # times resolve 1e-7 there
    assert isinstance(interval(grid.tolist()), float)
    assert interval([0.0, 1e6, 2e6 + 1e-4]) == 1e6
    assert interval([0.0, 0.5, math.nan]) == 0.5
    assert interval([math.nan, math.nan]) == interval([3.0]) == 0.0


def test_steps_that_differ_are_all_returned():
    for times in ([0.0, 0.5, 1.0 + 1e-8], [0.0, 1.0, 3.0], [0.0, 2.0, 3.0], [0.0, 1e-6, 2.01e-6]):
        steps = interval(times)
        assert torch.equal(steps, torch.tensor([times], dtype=torch.float64).diff(dim=1))
