"""Gauss-Hermite points: exact for polynomials, the Kalman filter on lines, and unscented in one dimension."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
import torch
from evaluating import composed
from sample_filters import F64, Linear, R, draw, kalman, linear, linear_problem

from ahnn.cli.build import build_all
from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.estimation.smoother import smoother
from ahnn_plugins.ukf import GaussHermiteFilter, UnscentedKalmanFilter, UnscentedParameters
from ahnn_plugins.ukf.gauss_hermite import hermite_rule


def moment(power):
    """The moment of a standard normal number."""
    return 0.0 if power % 2 else float(math.prod(range(power - 1, 0, -2)))


@pytest.mark.parametrize(("order", "size"), [(2, 1), (3, 1), (3, 2), (4, 2), (3, 3), (5, 1)])
def test_polynomials_up_to_their_degree_are_exact_and_no_further(order, size):
    nodes, weights = (part.numpy() for part in hermite_rule(order, size))
    assert len(nodes) == order**size
    assert np.all(weights > 0)
    for powers in product(range(2 * order), repeat=size):
        found = np.sum(weights[:, 0] * np.prod(nodes ** np.array(powers), axis=1))
        exact = math.prod(moment(p) for p in powers)
        scale = math.prod(moment(p + p % 2) for p in powers)
        assert found == pytest.approx(exact, rel=1e-11, abs=1e-11 * scale)
    beyond = np.sum(weights[:, 0] * nodes[:, 0] ** (2 * order))
    assert beyond < moment(2 * order) * (1 - 1e-3)


@pytest.mark.parametrize("smoothing", [False, True])
def test_on_a_linear_system_it_is_the_kalman_filter_and_the_smoother_of_the_unscented_one(smoothing):
    problem = linear_problem(0.1)
    result = GaussHermiteFilter().run(*problem, smoothing=smoothing)
    means, covariances, likelihoods = kalman(0.1, problem[2], problem[1].mean)
    torch.testing.assert_close(result.means, means, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(result.covariances, covariances, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(result.log_likelihood, likelihoods, rtol=1e-10, atol=1e-12)
    if smoothing:
        ours, theirs = (smoother(r) for r in (result, UnscentedKalmanFilter().run(*problem, smoothing=True)))
        torch.testing.assert_close(ours.means, theirs.means, rtol=1e-9, atol=1e-11)
        torch.testing.assert_close(ours.covariances, theirs.covariances, rtol=1e-9, atol=1e-11)


class Bent:
    names, units = ("a",), ("1",)

    def __call__(self, x, t):
        return x[..., :1].exp() + 0.3 * x[..., :1].square()


@pytest.mark.parametrize("smoothing", [False, True])
def test_in_one_dimension_it_is_the_unscented_filter_with_kappa_two(smoothing):
    def flow(x, dt):
        return x + dt * torch.sin(3.0 * x)

    rows = 1.0 + 0.3 * draw(2, 15, 1)
    rows[0, 3] = torch.nan
    options = Bent(), [[0.01]], [[0.04]], 0.1
    begin = initial_belief([[0.2], [-0.3]], [[0.3]])
    ours = GaussHermiteFilter(3).run(flow, begin, rows, *options, smoothing=smoothing)
    ukf = UnscentedKalmanFilter(UnscentedParameters(1.0, 0.0, 2.0))
    theirs = ukf.run(flow, begin, rows, *options, smoothing=smoothing)
    for name in ("means", "covariances", "log_likelihood", "nis", "innovations"):
        torch.testing.assert_close(getattr(ours, name), getattr(theirs, name), equal_nan=True)
    if smoothing:
        torch.testing.assert_close(smoother(ours).covariances, smoother(theirs).covariances)


def test_the_moments_of_squares_are_exact_where_unscented_ones_are_not():
    """Of x² with x ~ N(m, s²): mean m² + s², variance 4 m² s² + 2 s⁴; of x y with independent ones too."""
    m, s = torch.tensor([[0.7, -0.4]], dtype=F64), torch.tensor([0.5, 0.8], dtype=F64)

    def flow(x, dt):  # noqa: ARG001
        return torch.stack((x[:, 0].square(), x[:, 0] * x[:, 1]), -1)

    start, nothing = initial_belief(m, torch.diag(s**2)), torch.zeros(2, 2, dtype=F64)
    found = {}
    for one in (GaussHermiteFilter(3), UnscentedKalmanFilter(UnscentedParameters(1.0, 0.0, 0.0))):
        found[one.name] = one.predict(one.start(start), flow, 1.0, nothing).belief
    (a, b), (u, v) = m[0].tolist(), (s**2).tolist()
    mean = torch.tensor([[a * a + u, a * b]], dtype=F64)
    cross = 2 * a * b * u
    exact = [[4 * a * a * u + 2 * u * u, cross], [cross, a * a * v + b * b * u + u * v]]
    torch.testing.assert_close(found["ghkf"].mean, mean, rtol=1e-12, atol=0)
    torch.testing.assert_close(
        found["ghkf"].covariance[0], torch.tensor(exact, dtype=F64), rtol=1e-11, atol=0
    )
    assert float((found["ukf"].covariance[0] - torch.tensor(exact, dtype=F64)).abs().max()) > 0.05


class Turned:
    names, units = ("angle",), ("rad",)

    def __call__(self, x, t):
        return torch.remainder(x[..., :1] + math.pi, 2 * math.pi) - math.pi


def test_angles_beside_the_cut_are_averaged_across_it():
    gh = GaussHermiteFilter(5)
    belief = initial_belief([[math.pi - 0.1, 0.0]], 0.04 * np.eye(2))
    after, told = gh.update(gh.start(belief), [[-math.pi + 0.1]], Turned(), [[0.04]])
    assert float(told.residual) == pytest.approx(0.2, abs=1e-12)
    assert float(after.belief.mean[0, 0]) == pytest.approx(math.pi, abs=1e-12)


def test_a_missing_number_is_none_and_steps_are_the_run():
    gh = GaussHermiteFilter()
    flow, belief, rows, *rest = linear_problem(0.1, steps=5)
    whole, state = gh.run(flow, belief, rows, *rest), gh.start(belief)
    for row in rows.unbind(1):
        state = gh.predict(state, linear, rest[-1], rest[1])
        state, _ = gh.update(state, row, Linear(), R)
    assert torch.equal(state.belief.mean, whole.state.belief.mean)


def test_too_many_points_and_no_order_are_refused():
    with pytest.raises(UserError, match="order: expected a whole number >= 2; received 1"):
        GaussHermiteFilter(1)
    with pytest.raises(
        UserError, match="order: expected at most 20,000 points; received 3 nodes for each of 12"
    ):
        GaussHermiteFilter().start(initial_belief(np.zeros((1, 12)), np.eye(12)))


def test_the_option_is_that_filter():
    (plugin,) = build_all(composed("ghkf", "position").plugins, "plugins").values()
    assert plugin.estimator.name == "ghkf"
    assert list(plugin.estimator.smoothers) == ["smoothed"]
