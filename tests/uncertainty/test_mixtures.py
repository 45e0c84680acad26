"""Score and moments of mixtures, against integrals of distribution functions and sums by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from helpers import close, generator
from scipy.integrate import quad
from scipy.stats import norm

from ahnn.uncertainty import mixture_crps, mixture_moments

MEANS, DEVIATIONS = [-1.0, 0.4, 2.5], [0.3, 1.2, 0.05]


@pytest.mark.parametrize("truth", [-3.0, 0.2, 2.5])
def test_the_score_is_the_integral_of_the_squared_difference_of_distributions(truth):
    def squared(z):
        return (np.mean(norm.cdf(z, MEANS, DEVIATIONS)) - (z >= truth)) ** 2

    edges = sorted([-12.0, -1.0, 0.4, 2.3, 2.5, 2.7, truth, 12.0])
    wanted = sum(quad(squared, a, b, epsabs=1e-12)[0] for a, b in pairwise(edges) if a < b)
    found = mixture_crps(
        torch.tensor([truth], dtype=torch.float64),
        torch.tensor(MEANS, dtype=torch.float64)[:, None],
        torch.tensor(DEVIATIONS, dtype=torch.float64)[:, None],
    )
    assert float(found) == pytest.approx(wanted, rel=1e-8)


def test_members_without_a_width_are_steps_of_the_distribution():
    means = torch.tensor([[0.0], [1.0], [3.0]], dtype=torch.float64)
    # F is 1/3 from 0 on, 2/3 from 1 on and 1 from 3 on; the truth is 2: 1/9 + 4/9 + (1/3)^2.
    assert float(mixture_crps(torch.tensor([2.0]), means)) == pytest.approx(1 / 9 + 4 / 9 + 1 / 9)


def test_the_score_of_one_exact_member_is_its_error():
    truth, mean = torch.tensor([[1.0, -2.0]]), torch.tensor([[[0.5, 1.0]]])
    close(mixture_crps(truth, mean), torch.tensor([[0.5, 3.0]]), 1e-12)


def test_moments_are_those_of_draws_from_the_mixture():
    means = torch.randn(3, 2, generator=generator(0), dtype=torch.float64)
    roots = torch.randn(3, 2, 2, generator=generator(1), dtype=torch.float64)
    mean, covariance = mixture_moments(means, roots @ roots.mT)
    wanted = np.cov(means.numpy().T) + np.mean([root @ root.T for root in roots.numpy()], axis=0)
    close(mean, torch.from_numpy(means.numpy().mean(0)), 1e-12)
    close(covariance, torch.from_numpy(wanted), 1e-12)
