"""A prior chosen by evidence: closed forms of linear Gaussian models, and direct maximisation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import close, generator
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from ahnn.training.evidence import (
    BEGIN,
    Prior,
    by_evidence,
    determined,
    log_evidence,
    posterior_factor,
)

DOUBLE = {"dtype": torch.float64}


def linear_model(rows=40, sizes=(6, 3), seed=0):
    """Y = X theta + unit noise, the columns of very different sizes."""
    draw = generator(seed)
    scales = torch.logspace(-2, 1, sum(sizes), **DOUBLE)
    design = torch.randn(rows, sum(sizes), generator=draw, **DOUBLE) * scales
    theta = torch.randn(sum(sizes), generator=draw, **DOUBLE)
    theta[sizes[0] :] *= 0.3
    return design, design @ theta + torch.randn(rows, generator=draw, **DOUBLE)


def solved(design, y, prior):
    """The posterior mean of ridge regression, and the squared residuals there."""
    theta = torch.linalg.solve(design.T @ design + torch.diag(prior.precision), design.T @ y)
    return theta, (design @ theta - y).square().sum()


def exact(design, y, prior):
    """Log p(y | alpha): y is normal with covariance 1 + X diag(1 / alpha) X^T."""
    covariance = torch.eye(len(y)) + design @ torch.diag(1 / prior.precision) @ design.T
    return float(multivariate_normal(np.zeros(len(y)), covariance.numpy()).logpdf(y.numpy()))


@pytest.mark.parametrize("strengths", [[1.0, 1.0], [0.01, 30.0], [5.0, 1e-3]])
def test_the_evidence_of_a_linear_model_is_that_of_its_data(strengths):
    design, y = linear_model()
    prior = Prior(torch.tensor(strengths, **DOUBLE), (6, 3))
    theta, loss = solved(design, y, prior)
    found = log_evidence(design.T @ design, loss, len(y), theta, prior)
    assert found == pytest.approx(exact(design, y, prior), rel=1e-10)


def fixed_point(design, y, sizes):
    """Strengths and parameters in turn, as between the steps of a training."""
    prior = Prior(torch.ones(len(sizes), **DOUBLE), sizes)
    for _ in range(60):
        theta, _ = solved(design, y, prior)
        prior = by_evidence(design.T @ design, theta, sizes)
    return prior


@pytest.mark.parametrize("seed", range(3))
def test_strengths_are_those_of_the_largest_evidence(seed):
    design, y = linear_model(seed=seed)
    for sizes in ((9,), (6, 3)):
        prior = fixed_point(design, y, sizes)
        direct = minimize(
            lambda logs, sizes=sizes: -exact(design, y, Prior(torch.tensor(np.exp(logs)), sizes)),
            np.zeros(len(sizes)),
            method="Nelder-Mead",
            options={"xatol": 1e-6, "fatol": 1e-10},
        )
        for found, best in zip(prior.strengths.log().tolist(), direct.x, strict=True):
            assert found == pytest.approx(best, abs=2e-3)


def test_determined_parameters_are_counted():
    """Independent columns: gamma = sum of a / (a + alpha) with a = |column|^2."""
    squares = torch.tensor([100.0, 1.0, 0.01, 0.0], **DOUBLE)
    prior = Prior(torch.tensor([1.0, 4.0], **DOUBLE), (2, 2))
    factor = posterior_factor(torch.diag(squares), prior)
    close(factor @ factor.T, torch.diag(1 / (squares + prior.precision)), 1e-12)
    shares = squares / (squares + prior.precision)
    close(determined(factor, prior), shares.unflatten(0, (2, 2)).sum(1), 1e-12)


def test_a_group_that_no_data_or_no_size_speaks_of_keeps_its_strength():
    matrix = torch.diag(torch.tensor([50.0, 20.0, 0.0, 7.0], **DOUBLE))
    prior = by_evidence(matrix, torch.tensor([1.0, 2.0, 3.0, 0.0], **DOUBLE), (2, 1, 1))
    assert prior.strengths[1:].tolist() == [BEGIN, BEGIN]
    assert float(prior.strengths[0]) == pytest.approx(2 / 5, rel=0.02)


def test_what_rounding_makes_of_a_matrix_has_a_factor():
    """One direction that data know, a sum that is off by 4 units in the last place, and a weak prior."""
    count, size = 60, 1e16
    matrix = torch.full((count, count), size, **DOUBLE)
    matrix[0, 1] = matrix[1, 0] = size * (1 + 4 * torch.finfo(torch.float64).eps)
    assert float(torch.linalg.eigvalsh(matrix)[0]) < -5
    prior = Prior(torch.full((1,), 1e-3, **DOUBLE), [count])
    factor = posterior_factor(matrix, prior)
    known = torch.ones(count, **DOUBLE)
    assert float((known @ factor).square().sum()) == pytest.approx(1 / size, rel=1e-9)
    assert bool(by_evidence(matrix, known, [count]).strengths.isfinite())
