"""Shooting with starts eliminated: exact linear problems, central differences, outliers, sightings."""

from __future__ import annotations

import math
from functools import partial

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing, segment
from torch.nn.utils import parameters_to_vector

from ahnn.jacobians import step_jacobians
from ahnn.measurements import GroundStation, Instrument, Position, Segment, State
from ahnn.measurements.smoothing import guess
from ahnn.shooting.initial_states import HOPELESS, Trial, fit_starts, followed, growing, refine
from ahnn.shooting.path_sensitivities import steps_between
from ahnn.shooting.robust import ROBUST
from ahnn.training import LevenbergMarquardt, Shooting
from ahnn.training.maximum_posterior import WideProblem
from ahnn.training.shooting import UNMET, Limit, ShootingProblem, near


def trial(dynamics, robust="none"):
    rough = Swing().float()
    rough.load_state_dict(dynamics.state_dict())
    return Trial(dynamics.increment, partial(step_jacobians, rough.increment), ROBUST[robust])


@torch.no_grad()
def test_starts_of_a_linear_flow_are_the_least_squares_solution():
    """Q' = p, p' = -2 q: y_k = c e^{A t_k} x_0, solved by lstsq."""
    linear = Swing(2.0, 0.0)
    _, batch = segment(dynamics=linear, longest=0.005)
    steps = steps_between(batch.times, 0.005)
    close(fit_starts(trial(linear), guess(batch), batch, steps).starts, least_squares(batch, 2.0)[0], 1e-6)


def least_squares(batch, stiffness):
    """Starts of q' = p, p' = -k q that fit positions best, and the sum of squares that they leave."""
    a = torch.tensor([[0.0, 1.0], [-stiffness, 0.0]], **DOUBLE)
    design = torch.linalg.matrix_exp(a * (batch.times - batch.times[:, :1])[..., None, None])[..., 0, :]
    starts, left = [], 0.0
    for y, rows in zip(batch.values[..., 0], design, strict=True):
        rows, y = rows[~y.isnan()], y[~y.isnan()]
        starts.append(torch.linalg.lstsq(rows, y.unsqueeze(-1)).solution.squeeze(-1))
        left += float(((rows @ starts[-1] - y) / batch.instrument.deviations).square().sum())
    return torch.stack(starts), left


@torch.no_grad()
def test_starts_follow_the_parameters_where_one_direction_outgrows_the_others():
    """Q'' = 2 q grows along one direction of the start by e^9: the other has 1e-6 of the normal equations."""
    unstable = Swing(-2.0, 0.0)
    _, batch = segment(intervals=45, dynamics=unstable, longest=0.005)
    problem = ShootingProblem(unstable, batch, ROBUST["none"])
    theta = parameters_to_vector(unstable.parameters())
    for stiffness in (-2.0, -2.0001):
        moved = theta + torch.tensor([stiffness + 2.0, 0.0], **DOUBLE)
        assert float(problem.loss(moved)) == pytest.approx(least_squares(batch, stiffness)[1], rel=1e-4)


@torch.no_grad()
def test_starts_come_from_the_noise_alone_when_the_model_is_right():
    truth, batch = segment(rows=200, measurement=State(1), sd=0.02)
    steps = steps_between(batch.times, batch.instrument.longest)
    fitted = fit_starts(trial(Swing()), guess(batch), batch, steps)
    chi, starts = fitted.sums / (batch.measured - 2), fitted.starts
    assert 0.9 < float(chi.mean()) < 1.1
    assert float((starts - truth).square().mean().sqrt()) < 0.5 * 0.02


@torch.no_grad()
def test_an_outlier_among_the_first_samples_holds_no_start_fast():
    """Student's loss has a minimum for each sample that a start may have been guessed from."""
    truth, batch = segment(rows=60, sd=0.01, missing=0.0)
    values = batch.values.clone()
    values[:, 1] += 50 * 0.01
    batch = batch._replace(values=values)
    steps = steps_between(batch.times, batch.instrument.longest)
    ours = fit_starts(trial(Swing(), "student"), guess(batch), batch, steps)
    best = fit_starts(trial(Swing(), "student"), truth, batch, steps)
    assert float((ours.sums <= 1.001 * best.sums + 0.01).double().mean()) == 1


def reduced(problem, theta):
    """Residuals at the best starts of theta, flat, by many refits, and their cost."""
    with torch.no_grad():
        now = problem.trial(theta)
        fitted = refine(now, problem.starts, problem.batch, problem.steps, 12)
        states = fitted.states[:, problem.steps.ends]
        plain = problem.batch.residuals(states)
        return plain.flatten(), problem.robust.cost(plain).sum()


@pytest.mark.slow
@torch.no_grad()
def test_starts_follow_a_long_step_to_where_they_fit_best():
    """Of other dynamics, and of other parameters: two steps with derivatives of before do not get there."""
    _, batch = segment(rows=8, intervals=80, measurement=Position(1), longest=0.01)
    problem, after = WideProblem(Swing(), batch, ROBUST["none"]), Swing(2.01, 0.52)
    theta = parameters_to_vector(after.parameters())
    best = reduced(problem, theta)[1]
    assert float(problem.refitted(theta).sums.sum() / best - 1) > 1e-3
    others = WideProblem(after, batch, ROBUST["none"], starts=problem.starts)
    assert float(others.fitted.sums.sum() / best - 1) < 1e-6
    problem.follow(theta)
    followed_to = followed(problem.trial(theta), problem.starts, batch, problem.steps)
    assert float(followed_to.sums.sum() / best - 1) < 1e-6


@pytest.mark.parametrize("robust", ["none", "student"])
def test_normal_equations_are_those_of_the_reduced_residuals(robust):
    _, batch = segment(measurement=State(1), longest=0.01)
    wrong = Swing(2.005, 0.495)
    problem = ShootingProblem(wrong, batch, ROBUST[robust])
    theta = parameters_to_vector(wrong.parameters()).detach()
    loss, count, (block,) = problem.equations(theta, [2])
    e = 1e-4
    ahead, behind = ([reduced(problem, theta + s * d) for d in torch.eye(2, **DOUBLE)] for s in (e, -e))
    slopes = torch.stack([(a[1] - b[1]) / (4 * e) for a, b in zip(ahead, behind, strict=True)])
    close(block.gradient, slopes, 0.01)
    close(loss, reduced(problem, theta)[1], 1e-4)
    if robust == "none":  # Kaufman's Jacobian leaves out a term that is small as the noise is
        numeric = torch.stack([(a[0] - b[0]) / (2 * e) for a, b in zip(ahead, behind, strict=True)], -1)
        close(block.matrix, numeric.T @ numeric, 0.03)
    assert count == int(batch.measured.sum()) - 2 * len(batch.values)


def test_the_bend_is_the_second_difference_of_the_reduced_residuals():
    _, batch = segment(measurement=State(1), longest=0.01)
    wrong = Swing(2.005, 0.495)
    problem = ShootingProblem(wrong, batch, ROBUST["none"])
    theta, step = parameters_to_vector(wrong.parameters()).detach(), torch.tensor([0.1, -0.05], **DOUBLE)

    def second(e, v):
        ahead, here, behind = (reduced(problem, theta + s * v)[0] for s in (e, 0, -e))
        return (ahead - 2 * here + behind) / e**2, (ahead - behind) / (2 * e)

    slopes = torch.stack([second(1e-4, d)[1] for d in torch.eye(2, **DOUBLE)], -1)
    close(problem.bend(theta, step, 0.1), slopes.T @ second(0.1, step)[0], 0.02)


def test_an_outlier_bends_nothing_with_a_robust_loss():
    """It weighs as little as if it had not been measured, whose bend the one without it is."""
    _, batch = segment(measurement=State(1), longest=0.01, missing=0.0)
    wrong = Swing(2.005, 0.495)
    theta, step = parameters_to_vector(wrong.parameters()).detach(), torch.tensor([0.1, -0.05], **DOUBLE)
    far, missing = batch.values.clone(), batch.values.clone()
    far[:, 10, 1] += 1e5 * batch.instrument.deviations[1]
    missing[:, 10, 1] = torch.nan
    bends = [
        ShootingProblem(wrong, batch._replace(values=values), ROBUST["student"]).bend(theta, step, 0.1)
        for values in (far, missing, batch.values)
    ]
    close(bends[0], bends[1], 0.002)
    assert float((bends[2] - bends[1]).norm() / bends[1].norm()) > 0.01


def test_a_start_that_measurements_do_not_see_bends_nothing():
    _, batch = segment()

    class Blind(Position):
        def __call__(self, x, t):
            return 0 * super().__call__(x, t)

    problem = ShootingProblem(Swing(), batch, ROBUST["none"])
    problem.batch = batch._replace(instrument=batch.instrument._replace(measurement=Blind(1)))
    theta = parameters_to_vector(Swing().parameters()).detach()
    assert torch.equal(problem.bend(theta, 0.1 * theta, 0.1), torch.zeros_like(theta))


def test_an_exact_model_is_found_and_its_chi_square_is_one():
    _, batch = segment(rows=100, intervals=30, measurement=Position(1))
    model = Swing(1.7, 0.8)
    optimizer = LevenbergMarquardt(model.parameters(), damping=1e-4)
    objective = Shooting(None)
    for _ in range(6):
        chi = optimizer.step(lambda: (objective.problem(model, batch), None))
    assert 0.9 < float(chi) < 1.1
    covariance = torch.linalg.inv(
        objective.problem(model, batch)
        .equations(parameters_to_vector(model.parameters()).detach(), [2])[2][0]
        .matrix
    )
    error = parameters_to_vector(model.parameters()).detach() - torch.tensor([2.0, 0.5], **DOUBLE)
    assert float(error @ torch.linalg.solve(covariance, error)) < 13.8  # chi-square of 2, 99.9 %


@pytest.mark.parametrize("robust", ["none", "student"])
def test_the_gradient_for_first_order_optimisers_is_that_of_the_best_starts(robust):
    _, batch = segment(measurement=State(1), longest=0.01)
    model, objective = Swing(2.005, 0.495), Shooting(None, robust)
    residuals = objective.residuals(model, batch)
    (gradient,) = torch.autograd.grad(residuals.square().sum(), model.field.stiffness)
    problem = ShootingProblem(model, batch, ROBUST[robust])
    theta = parameters_to_vector(model.parameters()).detach()
    e = 1e-4
    losses = [
        reduced(problem, theta + e * d)[1] - reduced(problem, theta - e * d)[1]
        for d in torch.eye(2, **DOUBLE)
    ]
    close(gradient, torch.stack(losses) / (2 * e), 1e-3)


@pytest.mark.slow
def test_outliers_do_not_move_a_robust_fit():
    _, batch = segment(rows=50, intervals=20, measurement=Position(1), missing=0.0)
    wild = torch.rand(batch.values.shape, generator=generator(9)) < 0.05
    wild[:, :6] = False
    spoilt = batch._replace(values=torch.where(wild, batch.values + 0.5, batch.values))

    def fitted(data, robust):
        model = Swing(1.9, 0.6)
        optimizer = LevenbergMarquardt(model.parameters(), damping=1e-4)
        for _ in range(4):
            optimizer.step(lambda: (Shooting(None, robust).problem(model, data), None))
        return float((model.field.stiffness.detach() - torch.tensor([2.0, 0.5], **DOUBLE)).norm())

    clean = fitted(batch, "none")
    assert fitted(spoilt, "none") > 4 * clean
    assert fitted(spoilt, "student") < 2 * clean


def test_segments_that_do_not_converge_are_left_out_and_counted():
    _, batch = segment(rows=10)
    values = batch.values.clone()
    values[3] += 1e6 * torch.arange(values.shape[1], **DOUBLE).unsqueeze(-1).sin()
    problem = ShootingProblem(Swing(), batch._replace(values=values), ROBUST["none"])
    assert problem.lost == 1
    assert len(problem.starts) == 9
    degrees = batch.measured.double() - 2
    judged = Shooting(None).validation(Swing(), batch._replace(values=values))
    assert float(judged["lost"]) == pytest.approx(0.1, rel=1e-12)
    given_up = problem.fitted.sums.where(torch.arange(10) != 3, UNMET * degrees)
    close(judged["loss"], given_up.sum() / degrees.sum(), 1e-6)
    model = Swing()
    nothing = batch._replace(values=1e9 * torch.randn(values.shape, generator=generator(5), **DOUBLE))
    loss = LevenbergMarquardt(model.parameters()).step(lambda: (Shooting(None).problem(model, nothing), None))
    assert float(loss) == HOPELESS
    close(model.field.stiffness, torch.tensor([2.0, 0.5]), 0)
    validation = Shooting(None).validation(model, nothing)
    assert (float(validation["loss"]), float(validation["lost"])) == (UNMET, 1.0)
    degrees = torch.tensor([10, 10, 10, 10, 0])
    sums = torch.tensor([10.0, torch.inf, 1e10, 1.1e10, 1.0])
    assert near(sums, degrees).tolist() == [True, False, True, False, False]


def test_a_segment_far_from_the_others_counts_by_its_logarithm():
    sums, degrees = torch.tensor([8.0, 12.0, 10.0, 500.0], **DOUBLE), torch.tensor([10, 10, 10, 10])
    limit = Limit.of(sums, degrees)  # the lower median is 1 a degree, five of which are 50
    close(limit.cost(sums), torch.tensor([8.0, 12.0, 10.0, 50 * (1 + math.log(10))], **DOUBLE), 1e-12)
    step = 1e-4
    slope = (limit.cost(sums + step) - limit.cost(sums - step)) / (2 * step)
    close(limit.weight(sums), slope, 1e-6)
    assert float(Limit.of(sums * 1e-3, degrees).most[0]) == 50  # never below the noise


def test_a_wrong_region_moves_the_dynamics_instead_of_being_left_out():
    """One segment in ten has the only large amplitude: what it says of the cubic force must count."""
    _, batch = segment(rows=10)
    model = Swing(2.0, 1.0)
    problem = Shooting(None).problem(model, batch)
    theta = parameters_to_vector(model.parameters()).detach()
    far = problem.fitted.sums > problem.limit.most
    assert bool(far.any())
    assert problem.lost == 0
    step = 1e-5
    for k in range(2):
        shift = step * torch.nn.functional.one_hot(torch.tensor(k), 2).to(theta)
        slope = (problem.loss(theta + shift) - problem.loss(theta - shift)) / (4 * step)
        close(problem.equations(theta, [2]).blocks[0].gradient[k], slope, 2e-2)


def test_spans_of_a_fit_grow_by_a_factor_to_all_intervals():
    assert growing(288) == [5, 18, 72]
    assert growing(16) == [4]
    assert growing(8) == []


def test_ranges_and_angles_of_a_station_fit_a_start():
    """A free flight seen from the ground: x(t) is linear in the start, the sightings are not."""
    station = GroundStation(10.0, 20.0)
    x = torch.tensor([[8000.0, 3000.0, 2000.0, -1.0, 6.0, 3.0]], **DOUBLE)
    grid = 30.0 * torch.arange(20, **DOUBLE).unsqueeze(0)
    states = torch.cat(
        (x[:, None, :3] + grid.unsqueeze(-1) * x[:, None, 3:], x[:, None, 3:].expand(1, 20, 3)), -1
    )
    sd = torch.tensor([0.05, 3e-4, 3e-4], **DOUBLE)
    values = station(states, grid)
    batch = Segment(values, grid, Instrument(station, sd, 30.0, 3, 1.0))
    close(station.locate(values, grid), states[..., :3], 1e-12)
    drift = lambda z, dt: torch.cat((dt[:, None] * z[:, 3:], torch.zeros_like(z[:, 3:])), -1)  # noqa: E731
    rough = Trial(drift, partial(step_jacobians, drift), ROBUST["none"])
    begun = guess(batch) + torch.tensor([30.0, -20.0, 10.0, 0.1, 0.1, -0.1], **DOUBLE)
    close(fit_starts(rough, begun, batch, steps_between(grid, 30.0)).starts, x, 1e-6)
