"""Sampled paths: closed forms of maps, first-order covariances, causes common to starts and parameters."""

from __future__ import annotations

import pytest
import torch
from cases import Learned
from helpers import close, generator
from oscillators import DOUBLE, Swing
from torch import nn

from ahnn.errors import UserError
from ahnn.prediction.followed_path import Knowledge
from ahnn.prediction.propagation import predicted, together
from ahnn.shooting.path_sensitivities import path
from ahnn.uncertainty import Domain, Draws, drawn, rollout_covariances, sampled_paths, sampled_rollouts
from ahnn.uncertainty.domain import growth

FACTOR = torch.tensor([[2e-3, 0.0], [-1e-3, 3e-3]], **DOUBLE)
TIMES = torch.linspace(0, 3.2, 33, **DOUBLE)


class Rate(nn.Module):
    """Dx/dt = a x^2 + b: the state after a step of one is x + a x^2 + b."""

    clock = 0

    def __init__(self, a, b):
        super().__init__()
        self.a, self.b = (nn.Parameter(torch.tensor([one], **DOUBLE)) for one in (a, b))

    def increment(self, x, dt):
        return (self.a * x * x + self.b) * (dt.unsqueeze(-1) if isinstance(dt, torch.Tensor) else dt)

    def forward(self, x, dt):
        return x + self.increment(x, dt)


def after(dynamics, draws, steps=1, **options):
    *_, last = sampled_paths(dynamics, draws, torch.ones(steps, **DOUBLE), **options)
    return last


def test_a_quadratic_map_has_the_moments_of_a_squared_normal():
    """With x of mean m and deviation s: E x + a E x^2, and (1 + 2 a m)^2 s^2 + 2 a^2 s^4."""
    a, m, s = 0.5, 0.3, 0.4
    draws = drawn(
        torch.tensor([[m]], **DOUBLE), 40_000, 1, own=torch.tensor([[s]], **DOUBLE), common=None, spread=None
    )
    found = after(Rate(a, 0.0), draws)
    assert float(found.mean()) == pytest.approx(m + a * (m * m + s * s), rel=0.01)
    assert float(found.var()) == pytest.approx((1 + 2 * a * m) ** 2 * s**2 + 2 * a**2 * s**4, rel=0.03)


def test_effects_of_the_same_cause_on_start_and_parameters_cancel():
    start, spread = torch.tensor([[1.0], [2.0]], **DOUBLE), torch.tensor([[0.0], [0.7]], **DOUBLE)
    draws = drawn(start, 6, 0, own=None, common=torch.full((2, 1, 1), -0.7, **DOUBLE), spread=spread)
    assert float(draws.starts.std(0).min()) > 0.1
    close(after(Rate(0.0, 0.1), draws), (start + 0.1).expand(6, 2, 1), 1e-12)


def test_starts_are_independent_and_parameters_are_common():
    start, one = torch.zeros(2, 1, **DOUBLE), torch.ones(1, 1, **DOUBLE)
    own = drawn(start, 4000, 0, own=one, common=None, spread=None)
    spread = torch.tensor([[0.0], [1.0]], **DOUBLE)
    common = drawn(start, 4000, 0, own=None, common=None, spread=spread)
    for draws, dynamics, expected in ((own, Rate(0.0, 0.0), 0.0), (common, Rate(0.0, 0.0), 1.0)):
        found = after(dynamics, draws)[..., 0]
        assert float(torch.corrcoef(found.mT)[0, 1]) == pytest.approx(expected, abs=0.05)
        assert float(found.var()) == pytest.approx(1.0, abs=0.06)
        assert float(found.mean().abs()) < 1e-12  # pairs of opposite sign


def test_increments_are_linear_in_the_parameters_and_in_nothing_else():
    """Over two steps a displacement of a x^2 acts on a path that is itself displaced."""
    start, move = torch.tensor([[0.5]], **DOUBLE), torch.tensor([[0.2, 0.0]], **DOUBLE)
    found = after(Rate(0.3, 0.0), Draws(start.unsqueeze(0), move), 2)
    x = 0.5 + 0.5 * 0.5**2
    assert float(found) == pytest.approx(x + 0.5 * x * x, rel=1e-12)


def test_parameters_matter_more_beyond_the_training_data():
    class Seen(Rate):
        def seen(self, x):
            return x

    domain = Domain(torch.zeros(1, 1, **DOUBLE), 0.1)
    start, move = torch.tensor([[0.3]], **DOUBLE), torch.tensor([[0.0, 0.2]], **DOUBLE)
    found = after(Seen(0.0, 1.0), Draws(start.unsqueeze(0), move), domain=domain)
    assert float(found) == pytest.approx(1.3 + 0.2 * float(growth(torch.tensor(3.0, **DOUBLE))), rel=1e-12)


@torch.no_grad()
def test_small_errors_have_their_first_order_covariances():
    x = torch.randn(5, 2, generator=generator(4), **DOUBLE)
    dt = 0.02 * (0.5 + torch.rand(5, 150, generator=generator(5), **DOUBLE))
    sampled = sampled_rollouts(Swing(), x, dt, FACTOR, 1500).std(0)[:, 1:]
    linear = rollout_covariances(Swing(), x, dt, FACTOR).diagonal(dim1=-2, dim2=-1).sqrt()[:, 1:]
    assert float((sampled / linear).log().abs().median()) < 0.05
    again = sampled_rollouts(Swing(), x, dt, FACTOR, 2)
    close(again, sampled_rollouts(Swing(), x, dt, FACTOR, 2), 0.0)
    close(sampled_rollouts(Swing(), x, dt, 0 * FACTOR, 1)[0], path(Swing().increment, x, dt), 1e-12)


@torch.no_grad()
def test_a_prediction_by_samples_is_the_first_order_one_of_a_spring():
    start, factor = (
        torch.tensor([[1.0, 0.0], [0.2, 0.5]], **DOUBLE),
        torch.diag(torch.tensor([0.1, 0.3], **DOUBLE)),
    )
    known = Knowledge(start=factor)
    plain = predicted(Learned(), start, TIMES, 0.05, known)
    found = predicted(Learned(), start, TIMES, 0.05, known, samples=4000)
    close(found.states, plain.states, 1e-12)
    assert float((found.deviations / plain.deviations).log().abs().max()) < 0.05
    assert found.samples.shape == (2, 33, 4000, 2)
    close(found.samples.mean(2), found.states, 1e-12)
    both = together([found, found])
    assert both.samples.shape == (2, 33, 8000, 2)
    chosen = found.at(torch.tensor([0, 4]), TIMES[:2])
    close(chosen.samples, found.samples[:, [0, 4]], 0.0)


@torch.no_grad()
def test_wide_errors_of_an_oscillator_have_the_moments_of_many_paths():
    """Quadrature over both components of the start, which first-order bands miss by more than a third."""
    start, sd = torch.tensor([[1.5, 0.3]], **DOUBLE), torch.tensor([0.5, 0.8], **DOUBLE)
    known = Knowledge(start=sd.diag())
    found = predicted(Swing(), start, TIMES, 0.1, known, samples=4000)
    plain = predicted(Swing(), start, TIMES, 0.1, known)
    line = torch.linspace(-5, 5, 81, **DOUBLE)
    grid = torch.cartesian_prod(line, line)
    weights = torch.exp(-grid.square().sum(-1) / 2)
    weights = weights / weights.sum()
    ends = path(Swing().increment, start + grid * sd, TIMES.diff().expand(len(grid), -1))[:, -1]
    mean = weights @ ends
    deviations = (weights @ (ends - mean).square()).sqrt()
    close(found.states[0, -1], mean, 0.05)
    close(found.deviations[0, -1], deviations, 0.04)
    assert float((plain.deviations[0, -1] / deviations - 1).abs().max()) > 0.3


@pytest.mark.parametrize(("count", "factor"), [(1, 0.1), (True, 0.1), (2.5, 0.1), (-2, 0.1), (50, None)])
def test_what_cannot_be_sampled_is_refused(count, factor):
    known = Knowledge(start=None if factor is None else factor * torch.eye(2, **DOUBLE))
    message = "expected 2 paths or more" if factor else "expected a start or parameters with standard dev"
    with pytest.raises(UserError, match=f"samples: {message}"):
        predicted(Learned(), torch.ones(1, 2, **DOUBLE), TIMES, 0.05, known, samples=count)
