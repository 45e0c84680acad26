"""The covariance of parameters that measurements taught, on an oscillator whose two parameters are known."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.measurements import Position
from ahnn.shooting.robust import ROBUST
from ahnn.training import LevenbergMarquardt, laplace
from ahnn.training.evidence import by_evidence
from ahnn.training.laplace import conclude, held_out_scale
from ahnn.training.normal_equations import Block, Equations
from ahnn.training.posterior import WideProblem, with_prior
from ahnn.training.shooting import ShootingProblem

DOUBLE = {"dtype": torch.float64}
TRUE = torch.tensor([2.0, 0.5], **DOUBLE)


def learned(batch, steps=5):
    model = Swing(1.95, 0.55)
    optimizer = LevenbergMarquardt(model.parameters(), damping=1e-4)
    for _ in range(steps):
        optimizer.step(lambda: (WideProblem(model, batch, ROBUST["none"]), None))
    return model


def batch_of(seed, rows=40, longest=0.05):
    return segment(rows=rows, intervals=20, measurement=Position(1), seed=seed, longest=longest)[1]


def flat(model):
    return parameters_to_vector(model.parameters()).detach()


def test_the_covariance_is_that_of_repeated_experiments():
    """At the truth the step to the optimum is noise alone: in its covariance a chi-square of 2 each time."""
    total = 0.0
    for seed in range(12):
        batch = batch_of(seed, rows=10)
        found = conclude(Swing(), batch, batch, 0)
        total += float(found.offset @ torch.linalg.solve(found.factor @ found.factor.mT, found.offset))
    assert 9.9 < total < 45.6  # chi-square of 24: 0.5 % on either side


def test_too_small_a_standard_deviation_inflates_the_covariance():
    batch, other = batch_of(0), batch_of(1, rows=10)
    halved = lambda b: b._replace(  # noqa: E731
        instrument=b.instrument._replace(deviations=b.instrument.deviations / 2)
    )
    model = learned(batch)
    plain, blown = (conclude(model, *data, 0) for data in ((batch, other), (halved(batch), halved(other))))
    assert blown.inflation == pytest.approx(blown.about["chi_square"])
    assert blown.inflation == pytest.approx(4, rel=0.15)
    close(blown.covariance, max(plain.inflation, 1) * plain.covariance, 0.15)


def test_a_training_that_ended_early_says_how_far_it_is_from_its_optimum():
    batch, other = batch_of(0), batch_of(1, rows=10)
    optimum = flat(learned(batch, 7))
    early = Swing(2.01, 0.49)
    found = conclude(early, batch, other, 0)
    close(found.offset, optimum - flat(early), 0.1)
    assert found.about["remaining"] > 4
    error = flat(early) - TRUE
    assert float(error @ torch.linalg.solve(found.covariance, error)) < 13.8  # chi-square of 2, 99.9 %


def test_the_last_steps_end_in_the_optimum():
    batch, other = batch_of(0), batch_of(1, rows=10)
    optimum, model = flat(learned(batch, 7)), Swing(2.1, 0.4)
    found = conclude(model, batch, other, 4)
    assert found.about["remaining"] < 0.05 * found.about["determined"]
    gap = torch.linalg.solve(found.factor, flat(model) - optimum)  # in standard deviations
    assert float(gap.square().sum()) < 0.2


@pytest.mark.parametrize(("decrease", "steps"), [(1e-3, 1), (10.0, 4)])
def test_no_step_follows_one_that_gained_nothing(decrease, steps, monkeypatch):
    taken = []

    def lower(problem, here, damping):
        del problem
        taken.append(damping)
        return here.theta + 0.0, damping, decrease

    monkeypatch.setattr(laplace, "lower", lower)
    conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 4)
    assert len(taken) == steps


@pytest.mark.parametrize("gained", [1e-3, 10.0])
def test_what_is_left_is_no_more_than_the_last_step_gained_where_that_was_next_to_nothing(
    gained, monkeypatch
):
    promised = conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 0)
    lower = lambda problem, here, damping: (here.theta + 0.0, damping, gained)  # noqa: ARG005, E731
    monkeypatch.setattr(laplace, "lower", lower)
    found = conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 1)
    part = gained / promised.about["remaining"] if gained < 0.1 else 1.0
    assert found.about["remaining"] == pytest.approx(part * promised.about["remaining"], rel=1e-6)
    close(found.offset, part**0.5 * promised.offset, 1e-6)
    close(found.factor, promised.factor, 1e-6)


def test_nothing_is_said_where_nothing_is_explained():
    batch = batch_of(0)
    noise = 1e9 * torch.randn(batch.values.shape, generator=generator(5), **DOUBLE)
    assert conclude(Swing(), batch._replace(values=noise), batch, 2) is None


@pytest.mark.parametrize("factor", [1.0, 9.0, 100.0])
@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_held_out_measurements_find_the_scale_of_a_covariance(factor, noise):
    """Drawn from the model itself: theta off by N(0, f L L^T), and noise of some variance."""
    count, size = 2000, 100
    jacobian = torch.randn(count, size, generator=generator(0), **DOUBLE)
    lower = torch.randn(size, size, generator=generator(1), **DOUBLE).tril() / size
    off = factor**0.5 * lower @ torch.randn(size, generator=generator(2), **DOUBLE)
    rows = jacobian @ off + noise**0.5 * torch.randn(count, generator=generator(3), **DOUBLE)
    block = Block(torch.arange(size), jacobian.T @ jacobian, jacobian.T @ rows)
    found = held_out_scale(lower, Equations(rows @ rows, count, [block]), noise)
    assert found == (1.0 if factor == 1 else pytest.approx(factor, rel=0.4))


def test_no_held_out_measurements_ask_for_nothing():
    assert held_out_scale(torch.eye(2, **DOUBLE), Equations(torch.ones(()), 1, []), 1.0) == 1.0


def test_a_prior_adds_the_derivatives_of_its_penalty():
    problem = WideProblem(Swing(1.9, 0.6), batch_of(0), ROBUST["none"])
    theta = flat(Swing(1.9, 0.6))
    _, _, (block,) = problem.equations(theta, [2])
    prior = by_evidence(block.matrix, theta, [2])
    assert float(prior.strengths) == pytest.approx(2 / float(theta @ theta), rel=0.01)
    ours, at = with_prior(block, prior, theta), theta.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(prior.penalty(at) / 2, at)
    close(ours.gradient - block.gradient, gradient, 1e-6)
    close(ours.matrix - block.matrix, prior.strengths * torch.eye(2, **DOUBLE), 1e-6)


def test_equations_are_summed_in_float64():
    """Two parameters that act alike but for a part in a million: float32 cannot tell them apart."""
    _, batch = segment(rows=4)
    for kind, narrow in ((ShootingProblem, True), (WideProblem, False)):
        _, _, (block,) = kind(Swing(), batch, ROBUST["none"]).equations(flat(Swing()), [2])
        assert torch.equal(block.matrix.float().double(), block.matrix) == narrow
