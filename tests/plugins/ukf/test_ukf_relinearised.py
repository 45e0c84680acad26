"""The iterated smoother against posterior linearisation written out: one dense Gaussian over all states."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ahnn.estimation import initial_belief
from ahnn_plugins.ukf import UnscentedParameters, unscented_filter, unscented_smoother
from ahnn_plugins.ukf.iterated import iterated_smoother

F64 = torch.float64
STEPS, DT, SD = 9, 0.35, 0.05
Q, R = np.diag([1e-5, 4e-5]), np.array([[SD**2]])
PARAMETERS = UnscentedParameters(1.0, 0.0, 1.0)  # weights 1/3, and 1/6 of the four others


def pendulum(x, dt):
    p = x[..., 1] - dt * torch.sin(x[..., 0])
    return torch.stack((x[..., 0] + dt * p, p), dim=-1)


class Shadow:
    """How long the shadow of the bob is, in a light that turns."""

    names, units = ("shadow",), ("1",)

    def __call__(self, x, t):
        return torch.sin(x[..., :1] + 0.2 * torch.as_tensor(t, dtype=F64))

    def residual(self, y, y_pred):
        return y - y_pred


def line(function, mean, cov):
    """Slope, offset and covariance of what is left, of the regression over a Gaussian."""
    root = math.sqrt(3.0) * np.linalg.cholesky(cov).T
    points, weights = np.vstack((mean, mean + root, mean - root)), np.array([2, 1, 1, 1, 1]) / 6
    images = function(torch.from_numpy(points)).numpy()
    middle = weights @ images
    cross = (weights[:, None] * (points - mean)).T @ (images - middle)
    slope = np.linalg.solve(cov, cross).T
    rest = (weights[:, None] * (images - middle)).T @ (images - middle) - slope @ cov @ slope.T
    return slope, middle - slope @ mean, rest


def relinearised(means, covs, mean, cov, rows):
    """Smoothed moments of the affine model about some moments: the normal equations of all states."""
    size = 2 * (STEPS + 1)
    information, pull = np.zeros((size, size)), np.zeros(size)

    def tell(at, slope, value, noise):
        """The states at some places times a slope are a value, with noise."""
        weighted = slope.T @ np.linalg.inv(noise)
        information[np.ix_(at, at)] += weighted @ slope
        pull[at] += weighted @ value

    tell([0, 1], np.eye(2), mean, cov)
    for k in range(1, STEPS + 1):
        slope, offset, rest = line(lambda x: pendulum(x, DT), means[k - 1], covs[k - 1])
        both = np.hstack((-slope, np.eye(2)))
        tell([2 * k - 2, 2 * k - 1, 2 * k, 2 * k + 1], both, offset, Q + rest)
        if np.isfinite(rows[k - 1, 0]):
            slope, offset, rest = line(lambda x, t=k * DT: Shadow()(x, t), means[k], covs[k])
            tell([2 * k, 2 * k + 1], slope, rows[k - 1] - offset, R + rest)
    covariance = np.linalg.inv(information)
    blocks = [covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(STEPS + 1)]
    return (covariance @ pull).reshape(-1, 2), blocks


def all_of(smoothed, b):
    """Means and covariances of a member, the start included."""
    means = torch.cat((smoothed.initial.mean[:, None], smoothed.means), 1)[b].numpy()
    covs = torch.cat((smoothed.initial.covariance[:, None], smoothed.covariances), 1)[b].numpy()
    return means, covs


@pytest.fixture(scope="module")
def given():
    """Two pendulums from a wide start, seen at every third step, and what the filter says of them."""
    draw = torch.Generator().manual_seed(2)
    mean, cov = (
        torch.tensor([[0.6, 0.2], [-0.5, 0.4]], dtype=F64),
        torch.diag(torch.tensor([0.2, 0.1])).double(),
    )
    x = mean + torch.randn(2, 2, generator=draw, dtype=F64) @ cov.sqrt()
    rows = torch.full((2, STEPS, 1), torch.nan, dtype=F64)
    for k in range(STEPS):
        x = pendulum(x, DT)
        if k % 3 == 2:
            rows[:, k] = Shadow()(x, (k + 1) * DT) + SD * torch.randn(2, 1, generator=draw, dtype=F64)
    noise = torch.from_numpy(Q), torch.from_numpy(R)
    arguments = (rows, Shadow(), *noise, DT)
    result = unscented_filter(
        pendulum, initial_belief(mean, cov), *arguments, smoothing=True, parameters=PARAMETERS
    )
    return mean.numpy(), cov.numpy(), rows.numpy(), result, arguments


@pytest.mark.parametrize("count", [1, 3])
def test_each_iteration_linearises_about_the_last_smoothed_beliefs(given, count):
    mean, cov, rows, result, arguments = given
    found = iterated_smoother(result, pendulum, *arguments, parameters=PARAMETERS, iterations=count)
    assert found.iterations == count
    for b in range(2):
        means, covs = all_of(unscented_smoother(result), b)
        for _ in range(count):
            before = means
            means, covs = relinearised(means, covs, mean[b], cov, rows[b])
        got, spread = all_of(found.smoothed, b)
        assert np.abs(got - means).max() < 1e-8 * np.abs(means).max()
        assert max(np.abs(a - c).max() / np.abs(c).max() for a, c in zip(spread, covs, strict=True)) < 1e-6
        sizes = np.sqrt([np.diag(c) for c in covs])
        changes = np.abs((means - before) / sizes).max(1)
        assert float(found.change[b]) == pytest.approx(changes.max(), rel=1e-5)
        assert changes[0] > 0.3 * changes.max()  # that of the start counts as the others do


def test_it_ends_where_nothing_changes_any_more(given):
    mean, cov, rows, result, arguments = given
    found = iterated_smoother(result, pendulum, *arguments, parameters=PARAMETERS, iterations=50)
    assert 1 < found.iterations < 50
    assert found.settled.tolist() == [True, True]
    one = iterated_smoother(
        result, pendulum, *arguments, parameters=PARAMETERS, iterations=found.iterations - 1
    )
    assert not bool(one.settled.all())
    for b in range(2):
        means, covs = all_of(found.smoothed, b)
        again, _ = relinearised(means, covs, mean[b], cov, rows[b])
        assert float(np.abs((again - means) / np.sqrt([np.diag(c) for c in covs])).max()) < 1e-2
