"""Estimators that take an arc as a whole: batch least squares and the iterated smoother."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from scipy.stats import chi2

from ahnn.errors import UserError
from ahnn.estimation import Gate, initial_belief
from ahnn.estimation.arc_least_squares import Arc, followed
from ahnn.estimation.argument_checks import checked_sensor
from ahnn.estimation.batch_least_squares import batch_least_squares
from ahnn.estimation.consistency import nees
from ahnn.estimation.step_noise import StepGrid
from ahnn.measurements import Position
from ahnn_plugins.ukf import UnscentedParameters, unscented_filter, unscented_smoother
from ahnn_plugins.ukf.iterated import iterated_smoother

F64 = torch.float64
DT, SD = 0.1, 0.02


def pendulum(x, dt):
    p = x[:, 1] - dt * torch.sin(x[:, 0])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


def missing(problem):
    """The measurements of a linear problem with gaps: whole rows and single components."""
    rows = problem.measurements.clone()
    rows[:, 1::3] = torch.nan
    rows[0, 5, 0] = torch.nan
    return rows


@pytest.mark.parametrize(("size", "width"), [(2, 1), (6, 3)])
def test_iterating_changes_nothing_of_the_smoother_on_a_linear_system(make_linear, close, size, width):
    problem, model = make_linear(size, width, steps=60, batch=4, seed=size)
    belief, rows = initial_belief(problem.mean, problem.p0), missing(problem)
    arguments = (rows, model, problem.q, problem.r, 1.0)
    result = unscented_filter(problem.flow, belief, *arguments, smoothing=True)
    exact, found = unscented_smoother(result), iterated_smoother(result, problem.flow, *arguments)
    assert found.iterations == 1
    assert found.settled.tolist() == [True] * 4
    assert close(found.smoothed.means, exact.means, 1e-9)
    assert close(found.smoothed.covariances, exact.covariances, 1e-9, trailing=2)
    assert close(found.smoothed.initial.mean, exact.initial.mean, 1e-9)


@pytest.mark.parametrize(("size", "width"), [(2, 1), (6, 3)])
def test_least_squares_solves_the_normal_equations_of_a_linear_system(make_linear, close, size, width):
    problem, model = make_linear(size, width, steps=30, batch=4, seed=size)
    rows, belief = missing(problem), initial_belief(problem.mean, problem.p0)
    fit = batch_least_squares(problem.flow, belief, rows, model, problem.r, 1.0)
    assert fit.settled.tolist() == [True] * 4
    assert fit.status.tolist() == [0] * 4
    assert torch.equal(fit.measured, rows.isfinite().sum(-1))
    for b in range(4):
        # What is missing has no row, and the noise of the others is the block that is left.
        information = torch.linalg.inv(problem.p0)
        pull, power = information @ problem.mean[b], torch.eye(size, dtype=F64)
        for y in rows[b]:
            power, there = problem.a @ power, y.isfinite()
            h, inverse = problem.h[there] @ power, torch.linalg.inv(problem.r[there][:, there])
            information, pull = information + h.mT @ inverse @ h, pull + h.mT @ inverse @ y[there]
        covariance = torch.linalg.inv(information)
        assert close(fit.initial.mean[b], covariance @ pull, 1e-7)
        assert close(fit.initial.covariance[b], covariance, 1e-8, trailing=2)
        assert close(fit.means[b, -1], power @ covariance @ pull, 1e-7)
        last = fit.chols[b, -1]
        assert close(last @ last.mT, power @ covariance @ power.mT, 1e-7, trailing=2)


def wide(count, seed=0):
    """Pendulums from a wide start, seen every fifth step: (starts, belief, rows)."""
    generator = torch.Generator().manual_seed(seed)
    mean = torch.tensor([[0.8, 0.0]], dtype=F64).repeat(count, 1)
    start = x = mean + 0.3 * torch.randn(count, 2, generator=generator, dtype=F64)
    rows = []
    for _ in range(60):
        x = pendulum(x, DT)
        rows.append(x[:, :1] + SD * torch.randn(count, 1, generator=generator, dtype=F64))
    rows = torch.stack(rows, 1)
    rows[:, torch.arange(60) % 5 != 4] = torch.nan
    return start, initial_belief(mean, 0.09 * torch.eye(2)), rows


NOISE = (1e-14 * torch.eye(2), SD**2 * torch.eye(1), DT)


def test_near_a_wide_start_both_are_consistent_and_a_smoother_linearised_once_is_not():
    start, belief, rows = wide(1000)
    result = unscented_filter(pendulum, belief, rows, Position(1), *NOISE, smoothing=True)
    iterated = iterated_smoother(result, pendulum, rows, Position(1), *NOISE)
    fit = batch_least_squares(pendulum, belief, rows, Position(1), *NOISE[1:])
    assert bool(iterated.settled.all())
    assert bool(fit.settled.all())
    low, high = (chi2.ppf(p, 2000) / 1000 for p in (1e-3, 1 - 1e-3))
    means = [
        float(nees((b.mean - start)[:, None], b.chol[:, None]).mean())
        for b in (unscented_smoother(result).initial, iterated.smoothed.initial, fit.initial)
    ]
    assert means[0] > 1.3 * high
    assert low < means[1] < high
    assert low < means[2] < high
    # As many numbers as were measured: the prior adds as many as the start takes.
    low, high = (chi2.ppf(p, 12_000) / 1000 for p in (1e-3, 1 - 1e-3))
    assert low < float(fit.cost.mean()) < high


def test_least_squares_finds_the_minimum_that_scipy_finds():
    _, belief, rows = wide(3, seed=5)
    fit = batch_least_squares(pendulum, belief, rows, Position(1), *NOISE[1:])
    for b in range(3):

        def residuals(x0, b=b):
            x, parts = torch.from_numpy(x0)[None], [(x0 - belief.mean[b].numpy()) / 0.3]
            for k in range(60):
                x = pendulum(x, DT)
                if k % 5 == 4:
                    parts.append(((x[0, :1] - rows[b, k]) / SD).numpy())
            return np.concatenate(parts)

        best = least_squares(residuals, belief.mean[b].numpy(), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert fit.initial.mean[b].tolist() == pytest.approx(best.x.tolist(), rel=1e-5)
        covariance = np.linalg.inv(best.jac.T @ best.jac)
        assert np.allclose(fit.initial.covariance[b].numpy(), covariance, rtol=1e-3)
        assert float(fit.cost[b]) == pytest.approx(2 * best.cost, rel=1e-6)


def test_nothing_measured_leaves_the_prior():
    _, belief, rows = wide(2)
    fit = batch_least_squares(pendulum, belief, rows * torch.nan, Position(1), *NOISE[1:])
    assert torch.allclose(fit.initial.mean, belief.mean, rtol=1e-12)
    assert torch.allclose(fit.initial.covariance, belief.covariance, rtol=1e-9)
    assert float(fit.cost.abs().max()) < 1e-20


@pytest.mark.parametrize(("measured", "steps"), [([], 0), ([0], 1), ([1, 3], 4), ([5], 6)])
def test_paths_are_followed_up_to_the_last_measurement(measured, steps):
    start, belief, rows = wide(2)
    asked = []

    def flow(x, dt):
        asked.append(dt)
        return pendulum(x, dt)

    sensor = checked_sensor(Position(1), NOISE[1], belief, None)
    lengths = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    fit = followed(Arc(flow, StepGrid.of(lengths, 6, torch.zeros(())), rows, measured, sensor, belief), start)
    assert asked == lengths[:steps]
    assert fit.states.shape == (2, steps + 1, 2)
    assert fit.moved.shape == (2, steps + 1, 2, 2)


def test_a_member_that_is_lost_touches_no_other():
    _, belief, rows = wide(3)
    arguments = (rows, Position(1), *NOISE)

    def fragile(x, dt):
        out = pendulum(x, dt)
        out[: len(x) // 3] = torch.nan
        return out

    alone = iterated_smoother(
        unscented_filter(pendulum, belief, *arguments, smoothing=True), pendulum, *arguments
    )
    result = unscented_filter(fragile, belief, *arguments, smoothing=True)
    found = iterated_smoother(result, pendulum, *arguments)
    assert found.settled.tolist() == [False, True, True]
    assert bool(found.smoothed.means[0].isnan().all())
    assert torch.allclose(found.smoothed.means[1:], alone.smoothed.means[1:], rtol=1e-12)
    fit = batch_least_squares(fragile, belief, rows, Position(1), *NOISE[1:])
    sound = batch_least_squares(pendulum, belief, rows, Position(1), *NOISE[1:])
    assert fit.status.tolist() == [1, 0, 0]
    assert torch.allclose(fit.means[1:], sound.means[1:], rtol=1e-9)
    assert bool(fit.means[0].isnan().all())


def test_rows_that_the_gate_refused_stay_refused():
    _, belief, rows = wide(2)
    rows[0, 9] += 5.0
    gone = rows.clone()
    gone[0, 9] = torch.nan
    constants = (Position(1), *NOISE)
    gated = unscented_filter(pendulum, belief, rows, *constants, gate=Gate(0.9999), smoothing=True)
    clean = unscented_filter(pendulum, belief, gone, *constants, smoothing=True)
    assert bool(gated.rejected[0, 9])
    found, expected = (
        iterated_smoother(gated, pendulum, rows, *constants),
        iterated_smoother(clean, pendulum, gone, *constants),
    )
    assert torch.allclose(found.smoothed.means, expected.smoothed.means, rtol=1e-12)


def test_parameters_with_negative_weights_are_refused():
    _, belief, rows = wide(1)
    result = unscented_filter(pendulum, belief, rows, Position(1), *NOISE, smoothing=True)
    with pytest.raises(UserError, match="iterated smoother: expected alpha"):
        iterated_smoother(
            result, pendulum, rows, Position(1), *NOISE, parameters=UnscentedParameters(1.0, 0.0, -0.9)
        )
