"""Causes that move forecasts from a fitted start, against dense linear algebra."""

from __future__ import annotations

import pytest
import torch
from cases import SPRING, Learned, trajectories
from helpers import close

from ahnn.data.segments import whole
from ahnn.data.sensor import Sensor
from ahnn.evaluation.bands import NORMAL
from ahnn.evaluation.forecast_variances import Variances
from ahnn.evaluation.goodness_of_fit import trial_of
from ahnn.rollouts import rollout
from ahnn.shooting.initial_states import linearised
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.uncertainty import bands, forecast_columns

EVERY, NOISE = 4, 0.05
DOUBLE = {"dtype": torch.float64}


def basis(stiffness, count):
    """Positions (count, 2) and states (count, 2, 2) that follow from unit starts at the measured times."""
    states = rollout(Learned(stiffness), torch.eye(2, **DOUBLE), EVERY * SPRING.dt, count)
    return states[..., 0].mT, states.permute(1, 2, 0)


@torch.no_grad()
def test_variances_are_those_of_dense_linear_algebra(monkeypatch):
    """A spring is linear in its start: pseudo-inverses fit it, and central differences move the stiffness."""
    monkeypatch.setattr(bands, "CELLS", 1)  # one path at a time
    learned, sd = Learned(), 0.3
    sensor = Sensor(SPRING.space, measured="position", noise=NOISE, every=EVERY)
    segment = whole(sensor.measure(trajectories(SPRING, 5, 1), 0), sensor.instrument(SPRING.dt))
    segment = segment._replace(instrument=segment.instrument._replace(longest=EVERY * SPRING.dt))
    count, dof = segment.times.shape[1], 1
    early = torch.arange(count) < 12
    steps = steps_between(segment.times, segment.instrument.longest)
    starts = trajectories(SPRING, 5, 7).states[:, 0]
    states = path(learned.increment, starts, steps.lengths)
    here = linearised(trial_of(learned), states, segment, steps)
    causes = forecast_columns(
        learned, states, steps, here, early.expand(5, -1), torch.tensor([[sd]], **DOUBLE)
    )
    found = Variances.of(causes, here.of_state, torch.ones_like(states[:, steps.ends], dtype=torch.bool), 1)

    stiffness, h = float(learned.field.stiffness), 1e-4
    rows, moved = basis(stiffness, count)
    fit = torch.linalg.pinv(rows[early]) * NOISE
    of_noise = (moved @ fit).square().sum(-1)
    data = rows[early] @ starts.mT
    ends = []
    for k in (stiffness + h, stiffness - h):
        rows_k, moved_k = basis(k, count)
        ends.append(torch.einsum("tde,eb->btd", moved_k, torch.linalg.pinv(rows_k[early]) @ data))
    of_parameters = ((ends[0] - ends[1]) / (2 * h) * sd).square()
    close(found.states, of_noise + of_parameters, 2e-3)
    close(found.parameters, of_parameters, 2e-3)
    close(found.values, (of_noise + of_parameters)[..., :dof] / NOISE**2, 2e-3)
    shares = of_parameters / (of_noise + of_parameters)
    assert 0.1 < float(shares[:, -1].mean()) < 0.99  # both count


def test_draws_have_the_variances_of_the_causes():
    """Two trajectories in parts of one: noise of their own, parameters in common."""
    generator = torch.Generator().manual_seed(3)
    noise, moved = (torch.randn(2, 40, 2, n, generator=generator, **DOUBLE) for n in (2, 5))
    of_state, there = torch.zeros(2, 40, 1, 2, **DOUBLE), torch.ones(2, 40, 2, dtype=torch.bool)
    at_once = Variances.of([(noise, moved)], of_state, there, 5)
    in_parts = Variances.of(zip(noise.split(1), moved.split(1), strict=True), of_state, there, 5)
    assert bool((at_once.within == in_parts.within).all())
    close(at_once.states, noise.square().sum(-1) + moved.square().sum(-1), 1e-12)
    mean = at_once.within.double().mean(1) / there.sum()
    for share, normal in zip(mean.tolist(), NORMAL, strict=True):
        assert share == pytest.approx(normal, abs=0.02)


def test_draws_of_noise_and_parameters_are_not_the_same():
    """Causes that would cancel if they were: nothing would then be off."""
    size, there = (1, 30, 2, 2), torch.ones(1, 30, 2, dtype=torch.bool)
    one = torch.randn(size, generator=torch.Generator().manual_seed(3), **DOUBLE)
    found = Variances.of([(one, -one)], torch.zeros(1, 30, 1, 2, **DOUBLE), there, 2)
    assert float(found.within[0].double().mean()) / 60 < 0.8
