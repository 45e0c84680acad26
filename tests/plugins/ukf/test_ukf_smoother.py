"""The smoother against the textbook, and the consistency of filter and smoother."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from ahnn.estimation import initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter, unscented_smoother


def kalman_smoother(problem):
    """Textbook Kalman filter and RTS smoother of member 0, the start included."""
    a, h, q, r = (m.numpy() for m in (problem.a, problem.h, problem.q, problem.r))
    means, covs, predicted = [problem.mean[0].numpy()], [problem.p0.numpy()], []
    for y in problem.measurements[0].numpy():
        mean, cov = a @ means[-1], a @ covs[-1] @ a.T + q
        predicted.append((mean, cov))
        gain = np.linalg.solve(h @ cov @ h.T + r, h @ cov).T
        keep = np.eye(len(mean)) - gain @ h
        means.append(mean + gain @ (y - h @ mean))
        covs.append(keep @ cov @ keep.T + gain @ r @ gain.T)
    for k in range(len(predicted) - 1, -1, -1):
        mean, cov = predicted[k]
        gain = np.linalg.solve(cov, a @ covs[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - mean)
        covs[k] = covs[k] + gain @ (covs[k + 1] - cov) @ gain.T
    return torch.from_numpy(np.stack(means)), torch.from_numpy(np.stack(covs))


@pytest.mark.parametrize("form", [SQUARE_ROOT, STANDARD], ids=lambda form: form.name)
@pytest.mark.parametrize("alpha", [1.0, 0.01])
@pytest.mark.parametrize(("size", "width"), [(2, 1), (6, 3)])
def test_equals_the_rts_smoother_on_a_linear_system(make_linear, close, form, alpha, size, width):
    problem, model = make_linear(size, width, steps=200, seed=size)
    belief = initial_belief(problem.mean, problem.p0)
    result = unscented_filter(
        problem.flow,
        belief,
        problem.measurements,
        model,
        problem.q,
        problem.r,
        1.0,
        form=form,
        smoothing=True,
        parameters=UnscentedParameters(alpha),
    )
    smoothed = unscented_smoother(result)
    means, covs = kalman_smoother(problem)
    assert close(smoothed.means[0], means[1:], 1e-9)
    assert close(smoothed.covariances[0], covs[1:], 1e-9, trailing=2)
    assert close(smoothed.initial.mean, means[:1], 1e-9)
    assert close(smoothed.initial.covariance, covs[:1], 1e-9, trailing=2)


def test_smoothing_changes_nothing_of_the_filter(make_linear):
    problem, model = make_linear(4, 2, steps=20, seed=1)
    belief = initial_belief(problem.mean, problem.p0)
    arguments = (problem.flow, belief, problem.measurements, model, problem.q, problem.r, 1.0)
    plain, kept = unscented_filter(*arguments), unscented_filter(*arguments, smoothing=True)
    assert torch.equal(plain.means, kept.means)
    with pytest.raises(ValueError, match="smoothing=True"):
        unscented_smoother(plain)


def test_no_process_noise_smooths_to_one_trajectory(make_linear, close):
    problem, model = make_linear(3, 2, steps=40, seed=2)
    belief = initial_belief(problem.mean, problem.p0)
    zero = torch.zeros(3, 3, dtype=torch.float64)
    arguments = (problem.flow, belief, problem.measurements, model, zero, problem.r, 1.0)
    smoothed = unscented_smoother(unscented_filter(*arguments, smoothing=True))
    # Without noise the states are images of the start.
    x = smoothed.initial.mean
    for k in range(40):
        x = problem.flow(x, 1.0)
        if k < 10:
            assert close(smoothed.means[:, k], x, 1e-8)


@pytest.mark.parametrize(("size", "rank"), [(2, 1), (3, 2), (6, 1), (6, 3), (6, 5)])
def test_singular_predictions_are_smoothed_with_the_pseudo_inverse(make_linear, close, size, rank):
    problem, model = make_linear(size, 2, steps=5, batch=40, seed=10 * size + rank)
    left, values, right = torch.linalg.svd(problem.a)
    # The flow forgets all but `rank` directions, and no noise fills the others.
    a = 0.9 * left[:, :rank] @ (values[:rank, None] * right[:rank])
    q = torch.zeros(size, size, dtype=torch.float64)
    belief = initial_belief(problem.mean, problem.p0)
    result = unscented_filter(
        lambda x, _: x @ a.mT, belief, problem.measurements, model, q, problem.r, 1.0, smoothing=True
    )
    smoothed = unscented_smoother(result)
    assert torch.equal(smoothed.status, result.status)
    assert result.status.unique().tolist() == [0]
    assert torch.equal(smoothed.repairs, result.repairs)
    assert result.repairs.unique().tolist() == [5]
    # The start determines all: least squares on the whole arc.
    powers = [torch.linalg.matrix_power(a, k + 1) for k in range(5)]
    rows = torch.cat([problem.h @ power for power in powers])
    weight = torch.linalg.inv(torch.block_diag(*[problem.r] * 5))
    information = torch.linalg.inv(problem.p0) + rows.mT @ weight @ rows
    gain = torch.linalg.solve(information, rows.mT @ weight)
    residual = problem.measurements.flatten(1) - problem.mean @ rows.mT
    initial = problem.mean + residual @ gain.mT
    assert close(smoothed.initial.mean, initial, 1e-9)
    assert close(smoothed.initial.covariance, information.inverse().expand(40, -1, -1), 1e-9, trailing=2)
    for k, power in enumerate(powers):
        assert float((smoothed.means[:, k] - initial @ power.mT).abs().max()) < 1e-9


def test_two_states_that_become_one_have_a_finite_smoother():
    eye = torch.eye(2, dtype=torch.float64)
    result = unscented_filter(
        lambda x, _: torch.stack((x[:, 0], x[:, 0]), 1),
        initial_belief(torch.zeros(1, 2), eye),
        torch.ones(1, 5, 1),
        Position(1),
        0.0 * eye,
        eye[:1, :1],
        1.0,
        smoothing=True,
    )
    smoothed = unscented_smoother(result)
    # One unknown with a prior of variance 1, seen five times.
    assert torch.allclose(smoothed.means, torch.full((1, 5, 2), 5.0 / 6.0, dtype=torch.float64), rtol=1e-12)
    assert torch.allclose(smoothed.initial.covariance, torch.diag(torch.tensor([1 / 6, 1.0])).double())
    assert smoothed.repairs.tolist() == [5]


def pendulum(x, dt):
    p = x[:, 1] - dt * torch.sin(x[:, 0])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


@pytest.fixture(scope="module")
def consistent():
    """Pendulums that obey the law the filter assumes: (truth, result, smoothed)."""
    batch, steps = 400, 60
    generator = torch.Generator().manual_seed(4)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    mean = torch.tensor([[0.8, 0.0]], dtype=torch.float64).repeat(batch, 1)
    x = mean + 0.05 * normal(batch, 2)
    truth, rows = [], []
    for _ in range(steps):
        x = pendulum(x, 0.05) + 0.01 * normal(batch, 2)
        truth.append(x)
        rows.append(x[:, :1] + 0.05 * normal(batch, 1))
    belief = initial_belief(mean, 0.0025 * torch.eye(2))
    noise = 1e-4 * torch.eye(2), 0.0025 * torch.eye(1)
    result = unscented_filter(
        pendulum, belief, torch.stack(rows, 1), Position(1), *noise, 0.05, smoothing=True
    )
    return torch.stack(truth, 1), result, unscented_smoother(result)


def nees(error, chol):
    white = torch.linalg.solve_triangular(chol, error.unsqueeze(-1), upper=False)
    return white.square().sum((-2, -1))


def test_nees_and_nis_lie_in_their_bands(consistent):
    truth, result, smoothed = consistent
    members = len(truth)
    # At one time the members are independent: B times the mean NEES is chi-square with B D degrees.
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 2 * members) / members
    for k in (0, 19, 39, 59):
        assert low < float(nees(truth - result.means, result.chols)[:, k].mean()) < high
        assert low < float(nees(truth - smoothed.means, smoothed.chols)[:, k].mean()) < high
    # The innovations of a consistent filter are independent in time as well.
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], result.nis.numel()) / result.nis.numel()
    assert low < float(result.nis.mean()) < high


def test_smoothing_reduces_the_error(consistent):
    truth, result, smoothed = consistent
    filtered = (truth - result.means)[:, 10:50].square().mean()
    assert float((truth - smoothed.means)[:, 10:50].square().mean()) < 0.8 * float(filtered)


def test_a_failed_member_is_smoothed_up_to_its_failure():
    calls = 0

    def flow(x, dt):
        nonlocal calls
        calls += 1
        out = pendulum(x, dt)
        if calls > 12:
            out[:5] = torch.nan
        return out

    generator = torch.Generator().manual_seed(0)
    rows = 0.1 * torch.randn(2, 20, 1, generator=generator, dtype=torch.float64)
    belief = initial_belief(torch.zeros(2, 2, dtype=torch.float64), 0.01 * torch.eye(2))
    noise = 1e-4 * torch.eye(2), 0.01 * torch.eye(1)

    def run(flow, rows):
        return unscented_smoother(
            unscented_filter(flow, belief, rows, Position(1), *noise, 0.05, smoothing=True)
        )

    spoiled = run(flow, rows)
    clean, shorter = run(pendulum, rows), run(pendulum, rows[:, :12])
    assert torch.equal(spoiled.means[1], clean.means[1])
    assert torch.equal(spoiled.means[0, :12], shorter.means[0])
    assert torch.equal(spoiled.chols[0, :12], shorter.chols[0])
    assert torch.equal(spoiled.initial.mean[0], shorter.initial.mean[0])
    assert bool(torch.isnan(spoiled.means[0, 12:]).all())


def test_predictions_that_have_an_inverse_are_not_decomposed(make_linear, monkeypatch):
    problem, model = make_linear(4, 2, steps=3)
    monkeypatch.setattr(torch.linalg, "svdvals", lambda _: pytest.fail("decomposed"))
    rows, belief = problem.measurements, initial_belief(problem.mean, problem.p0)
    arguments = (problem.flow, belief, rows, model, problem.q, problem.r, 1.0)
    assert unscented_filter(*arguments, smoothing=True).repairs.tolist() == [0]
    with pytest.raises(pytest.fail.Exception, match="decomposed"):
        unscented_filter(
            lambda x, _: 0.0 * x, *arguments[1:4], 0.0 * problem.q, problem.r, 1.0, smoothing=True
        )


@pytest.mark.parametrize("unit", [1.0, 1e-14])
def test_what_has_no_inverse_does_not_depend_on_units(unit):
    """Two states become one, and a third, of any unit, is seen as well as they are."""
    sizes = torch.tensor([1.0, 1.0, unit], dtype=torch.float64)
    result = unscented_filter(
        lambda x, _: torch.stack((x[:, 0], x[:, 0], x[:, 2]), 1),
        initial_belief(torch.zeros(1, 3), torch.diag(sizes**2)),
        torch.ones(1, 5, 3) * sizes,
        Position(3),
        torch.zeros(3, 3, dtype=torch.float64),
        torch.diag(sizes**2),
        1.0,
        smoothing=True,
    )
    smoothed = unscented_smoother(result)
    expected = torch.tensor([1 / 11, 1.0, 1 / 6], dtype=torch.float64)  # ten, none and five measurements
    found = torch.diagonal(smoothed.initial.covariance[0]) / sizes**2
    assert torch.allclose(found, expected, rtol=1e-9)
    assert torch.allclose(smoothed.initial.mean[0] / sizes, 1 - expected, rtol=1e-9)
