"""Cubature points: 2 D of one weight, exact for polynomials of the third degree."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import torch
from evaluating import composed

from ahnn.cli.build import build_all
from ahnn.estimation import initial_belief
from ahnn_plugins.ukf import UnscentedKalmanFilter, UnscentedParameters
from ahnn_plugins.ukf.sigma_points import draw, unscented_weights

CUBATURE, F64 = UnscentedParameters(1.0, 0.0, 0.0), torch.float64


def expected(function, mean, chol, order=8):
    """Integral of a function over a Gaussian by a product of Gauss-Hermite rules."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    total = 0.0
    for places in product(range(order), repeat=len(mean)):
        x = mean + chol @ nodes[list(places)]
        total = total + np.prod(weights[list(places)]) / (2 * np.pi) ** (len(mean) / 2) * function(x)
    return total


@pytest.mark.parametrize("size", [1, 2, 3])
def test_they_are_the_points_of_arasaratnam_and_haykin(size):
    """Third degree: means are exact for cubic functions, covariances for linear ones (their section V)."""
    weights = unscented_weights(CUBATURE, size)
    assert float(weights.mean_centre) == float(weights.covariance_centre) == 0.0
    assert float(weights.outer) == pytest.approx(1 / (2 * size))
    assert float(weights.radius) == pytest.approx(size**0.5)
    belief = initial_belief(np.arange(1.0, size + 1)[None], np.eye(size) + 0.5)
    points = draw(belief, weights)[0, 1:].numpy()
    mean, chol = belief.mean[0].numpy(), belief.chol[0].numpy()
    for a, b, c in product(range(size), repeat=3):
        exact = expected(lambda x, k=(a, b, c): x[k[0]] * x[k[1]] * x[k[2]], mean, chol)
        assert (points[:, a] * points[:, b] * points[:, c]).mean() == pytest.approx(exact, rel=1e-12)


def test_a_prediction_is_their_sum_over_points():
    def flow(x, dt):
        return x + dt * torch.stack((torch.sin(x[:, 1]), x[:, 0].square()), -1)

    ckf = UnscentedKalmanFilter(CUBATURE, name="ckf")
    belief, q = initial_belief([[0.3, -0.5]], [[0.4, 0.1], [0.1, 0.3]]), 0.01 * torch.eye(2, dtype=F64)
    after = ckf.predict(ckf.start(belief), flow, 0.5, q).belief
    offsets = 2**0.5 * belief.chol[0].mT
    images = flow(belief.mean + torch.cat((offsets, -offsets)), 0.5)
    torch.testing.assert_close(after.mean[0], images.mean(0), rtol=1e-13, atol=0)
    expected = (images - images.mean(0)).mT @ (images - images.mean(0)) / 4 + q
    torch.testing.assert_close(after.covariance[0], expected, rtol=1e-12, atol=1e-15)


def test_the_option_is_that_filter_under_its_own_name():
    (plugin,) = build_all(composed("ckf", "position").plugins, "plugins").values()
    assert plugin.estimator.name == "ckf"
    assert plugin.parameters == CUBATURE
