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
from ahnn.training.evidence import Prior, by_evidence
from ahnn.training.laplace import conclude
from ahnn.training.maximum_posterior import PosteriorPoint, WideProblem, with_prior
from ahnn.training.normal_equations import Block, Equations
from ahnn.training.parameter_covariance import Noise, held_out_scale, scatter, uncertainty
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


@pytest.mark.slow
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


@pytest.fixture
def ends_early(monkeypatch):
    """No further steps for trainings that have not reached their optimum."""
    monkeypatch.setattr(laplace, "FURTHER", 0)


@pytest.mark.usefixtures("ends_early")
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


@pytest.mark.usefixtures("ends_early")
@pytest.mark.parametrize(("share", "steps"), [(0.0495, 1), (0.0505, 4)])
def test_no_step_follows_one_that_gained_nothing(share, steps, monkeypatch):
    """Beside what noise alone gives each parameter that the data determine."""
    taken = []

    def lower(problem, here, damping):
        del problem
        taken.append(damping)
        return here.theta + 0.0, damping, share * here.determined

    monkeypatch.setattr(laplace, "lower", lower)
    conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 4)
    assert len(taken) == steps


@pytest.mark.usefixtures("ends_early")
@pytest.mark.parametrize("share", [0.0495, 0.0505])
def test_what_is_left_is_no_more_than_the_last_step_gained_where_that_was_next_to_nothing(share, monkeypatch):
    promised = conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 0)
    gained = share * promised.about["determined"]
    lower = lambda problem, here, damping: (here.theta + 0.0, damping, gained)  # noqa: ARG005, E731
    monkeypatch.setattr(laplace, "lower", lower)
    found = conclude(Swing(2.01, 0.49), batch_of(0), batch_of(1, rows=10), 1)
    part = gained / promised.about["remaining"] if share < 0.05 else 1.0
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
    found = held_out_scale(lower, Equations(rows @ rows, count, [block]), noise, 2 * noise**2)
    assert found == 1.0 if factor == 1 else 0.4 * factor < found < 1.2 * factor


def test_no_held_out_measurements_ask_for_nothing():
    assert held_out_scale(torch.eye(2, **DOUBLE), Equations(torch.ones(()), 1, []), 1.0, 2.0) == 1.0


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


def place(**changes):
    """Two parameters that the data determine by 1.5, 8 residuals; 2 standard deviations from the optimum."""
    block = Block(torch.arange(2), torch.eye(2, **DOUBLE), torch.ones(2, **DOUBLE))
    prior = Prior(torch.full((1,), 0.5, **DOUBLE), [2])
    theta, pull = torch.tensor([3.0, -1.0], **DOUBLE), torch.tensor([-2.0, 0.0], **DOUBLE)
    known = PosteriorPoint(
        theta, torch.tensor(26.0, **DOUBLE), 8, block, prior, torch.eye(2, **DOUBLE), 1.5, pull
    )
    return known._replace(**changes)


@pytest.mark.parametrize(("gained", "part"), [(0.0, 0.0), (0.04, 0.01), (1.0, 0.25), (4.0, 1.0), (9.0, 1.0)])
def test_a_place_that_was_arrived_at_is_as_far_from_the_optimum_as_the_last_step_gained(gained, part):
    found = place().left(gained)
    assert found.remaining == pytest.approx(4.0 * part, rel=1e-12)
    close(found.offset, torch.tensor([2.0 * part**0.5, 0.0], **DOUBLE), 1e-12)
    there = place(pull=torch.zeros(2, **DOUBLE)).left(gained)
    assert (there.remaining, float(there.offset.abs().max())) == (0.0, 0.0)


def test_the_objective_is_residuals_and_prior():
    """26 of the residuals, and 0.5 (3^2 + 1^2) of the prior."""
    assert place().objective == pytest.approx(31.0, rel=1e-12)


@pytest.mark.parametrize(("degrees", "expected"), [(8, 4.0), (3, 26 / 1.5), (2, 26.0), (1, 26.0)])
def test_chi_square_is_by_the_degrees_that_the_parameters_leave_and_by_one_at_least(degrees, expected):
    assert place(degrees=degrees).chi_square == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("loss", "chi_square"), [(26.0, 4.0), (3.25, 0.5)])
@pytest.mark.parametrize("unexplained", [1.0, 3.0])
@pytest.mark.parametrize("widening", [1.0, 0.4])
def test_the_covariance_is_widened_by_chi_square_and_by_what_is_held_out(
    loss, chi_square, unexplained, widening, monkeypatch
):
    asked = []
    scale = "ahnn.training.parameter_covariance.held_out_scale"
    monkeypatch.setattr(scale, lambda *given: asked.append(given) or unexplained)
    held_out = Equations(torch.ones(()), 1, [])
    found = uncertainty(place(loss=torch.tensor(loss, **DOUBLE)), held_out, {"a": 0.5}, Noise(widening, 7.0))
    wide = max(chi_square * widening, 1.0)
    assert found.inflation == pytest.approx(wide * unexplained, rel=1e-12)
    offset = torch.tensor([[4.0, 0.0], [0.0, 0.0]], **DOUBLE)
    close(found.covariance, wide * unexplained * (torch.eye(2, **DOUBLE) + offset), 1e-12)
    (spread, test, noise, scattered), *_ = asked
    close(spread @ spread.T, wide * (torch.eye(2, **DOUBLE) + offset), 1e-12)
    assert (test, noise, scattered) == (held_out, pytest.approx(chi_square, rel=1e-12), 7.0)
    assert found.about["held_out"] == unexplained


@pytest.mark.parametrize("noise", [0.7, 3.0])
@pytest.mark.parametrize("factor", [1.0, 1.02, 7.0, 400.0])
@pytest.mark.parametrize("told", [[0.3, 2.0, 11.0], [5.0, 0.0, 0.0]])
@pytest.mark.parametrize("tails", [0.0, 40.0])
def test_held_out_measurements_widen_a_covariance_until_they_do_not_refuse_it(noise, factor, told, tails):
    """Squares of n + R normal numbers: n of variance v, and by each direction its own variance more.

    The squares of a noise with tails vary by more than those of a normal one.
    """
    told = torch.tensor(told, **DOUBLE)
    lower = torch.diag(torch.tensor([2.0, 0.5, 0.1], **DOUBLE))
    block = Block(torch.arange(3), torch.diag(told / lower.diagonal() ** 2), torch.zeros(3, **DOUBLE))
    variance = 2 * ((noise + factor * told).square().sum() + (50 - 3) * noise**2) + 50 * tails
    excess = factor * float(told.sum()) + 3.0902 * float(variance) ** 0.5
    for share, least in ((1.0, factor), (0.9 / factor, 1.0), (-1.0, 1.0)):
        test = Equations(torch.tensor(50 * noise + share * excess, **DOUBLE), 50, [block])
        found = held_out_scale(lower, test, noise, 2 * noise**2 + tails)
        assert found == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize(("tails", "expected"), [(0.0, 4.5), (0.1, 0.9 * 4.5 + 0.1 * 0.9 * 50**2)])
def test_sums_of_segments_tell_how_residuals_scatter(tails, expected):
    """Squares of normal numbers of variance 1.5, some of which give way to outliers whose cost is 51.5."""
    rng = generator(0)
    count = torch.randint(10, 90, (4000,), generator=rng)
    squares = 1.5 * torch.randn(4000, 90, generator=rng, **DOUBLE).square()
    squares[torch.rand(4000, 90, generator=rng) < tails] = 51.5
    sums = torch.where(torch.arange(90) < count.unsqueeze(1), squares, 0.0).sum(1)
    assert scatter(sums, count.double()) == pytest.approx(expected, rel=0.07)


def test_few_segments_that_agree_scatter_as_normal_residuals_do():
    sums = torch.full((3,), 60.0, **DOUBLE)
    assert scatter(sums, torch.full((3,), 20.0, **DOUBLE)) == pytest.approx(2 * 3.0**2, rel=1e-12)


class Line:
    """Residuals theta - goal, whose bend is too large for so many steps, and nothing after them."""

    def __init__(self, too_large, goal):
        self.left, self.goal = too_large, goal

    def loss(self, theta):
        return (theta - self.goal).square().sum()

    def bend(self, theta, step, reach):
        del step, reach
        self.left -= 1
        return torch.full_like(theta, 1e9 if self.left >= 0 else 0.0)


@pytest.mark.parametrize(("too_large", "damping"), [(0, 1e-3 / 3), (1, 1e-2 / 3), (3, 1.0 / 3)])
def test_a_step_beyond_its_bend_is_damped_ten_times_as_much(too_large, damping):
    here = place(prior=Prior(torch.full((1,), 1e-9, **DOUBLE), [2]))
    line = Line(too_large, here.theta - here.block.gradient)
    before = float(line.loss(here.theta) + here.prior.penalty(here.theta))
    here = here._replace(loss=line.loss(here.theta))
    theta, found, decrease = laplace.lower(line, here, 1e-3)
    assert found == pytest.approx(damping, rel=1e-9)
    assert before - float(line.loss(theta) + here.prior.penalty(theta)) == pytest.approx(decrease, rel=1e-9)
    close(theta, here.theta - here.block.gradient / (1 + 3 * damping), 1e-2)


def test_no_step_is_taken_where_all_go_beyond_their_bend_and_the_damping_stays_in_its_range():
    assert laplace.lower(Line(99, torch.zeros(2, **DOUBLE)), place(), 1e-3) == (None, pytest.approx(1e3), 0.0)
    assert laplace.lower(Line(99, torch.zeros(2, **DOUBLE)), place(), 1e3) == (None, 1e6, 0.0)
