"""The reference sampler of the benchmarks, against distributions with known moments."""

import importlib.util
import math
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def hmc():
    """The sampler, which is no part of the package."""
    path = ROOT / "benchmarks" / "hamiltonian_monte_carlo.py"
    spec = importlib.util.spec_from_file_location("hamiltonian_monte_carlo", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def linear_problem():
    """Return design, measurements, prior precision, and the closed-form posterior of linear regression."""
    generator = torch.Generator().manual_seed(4)
    design = torch.randn(12, 5, generator=generator, dtype=torch.float64)
    values = torch.randn(12, generator=generator, dtype=torch.float64) + design.sum(1)
    prior = torch.tensor([0.5, 1.0, 2.0, 4.0, 8.0], dtype=torch.float64)
    precision = design.T @ design + torch.diag(prior)
    covariance = torch.linalg.inv(precision)
    return design, values, prior, covariance @ design.T @ values, covariance


def test_a_linear_problem_has_its_closed_form_posterior(hmc):
    design, values, prior, mean, covariance = linear_problem()
    # A wrong centre and a wrong scale, as those of an approximate posterior.
    centre, factor = mean + 0.3, 1.5 * torch.linalg.cholesky(covariance)

    def density(u):
        theta = centre + u @ factor.T
        misfit = (theta @ design.T - values).square().sum(-1)
        return -0.5 * (misfit + (prior * theta.square()).sum(-1))

    begin = 2 * torch.randn(8, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    chains = hmc.sampled(density, begin, warmup=100, draws=400, leaps=4, seed=0)
    theta = centre + chains.draws @ factor.T
    assert 0.6 < chains.acceptance < 0.95
    assert float(hmc.split_rhat(theta).max()) < 1.02
    count = hmc.effective_draws(theta)
    assert float(count.min()) > 500
    deviation = covariance.diagonal().sqrt()
    off = (theta.mean((0, 1)) - mean) / deviation * count.sqrt()
    assert float(off.abs().max()) < 4
    rows = (theta.flatten(0, 1) - mean) @ torch.linalg.cholesky(torch.linalg.inv(covariance))
    second = rows.T @ rows / len(rows)  # the identity
    assert float((second - torch.eye(5)).abs().max()) < 5 * math.sqrt(2 / float(count.min()))


def test_a_density_far_from_normal_keeps_its_moments(hmc):
    # v ~ N(0, 1) and w | v ~ N(v^2, 0.5^2): E w = 1, var w = 2 + 0.25.
    def density(u):
        v, w = u.unbind(-1)
        return -0.5 * (v.square() + ((w - v.square()) / 0.5).square())

    begin = torch.zeros(20, 2, dtype=torch.float64)
    chains = hmc.sampled(density, begin, warmup=200, draws=500, leaps=8, seed=3)
    v, w = chains.draws.flatten(0, 1).unbind(-1)
    least = float(hmc.effective_draws(chains.draws).min())
    assert least > 400
    assert abs(float(v.mean())) < 4 / math.sqrt(least)
    assert abs(float(v.var()) - 1) < 4 * math.sqrt(2 / least)
    assert abs(float(w.mean()) - 1) < 4 * math.sqrt(2.25 / least)


def test_diagnostics_of_a_known_process(hmc):
    # An AR(1) process of correlation a has the effective number N (1 - a) / (1 + a).
    generator, a = torch.Generator().manual_seed(0), 0.6
    steps = torch.randn(4, 20_000, 1, generator=generator, dtype=torch.float64)
    draws = [steps[:, 0]]
    for k in range(1, steps.shape[1]):
        draws.append(a * draws[-1] + math.sqrt(1 - a * a) * steps[:, k])
    process = torch.stack(draws, dim=1)
    assert float(hmc.effective_draws(process)) == pytest.approx(4 * 20_000 * (1 - a) / (1 + a), rel=0.05)
    assert float(hmc.split_rhat(process)) < 1.01
    apart = process + torch.arange(4.0)[:, None, None]
    assert float(hmc.split_rhat(apart)) > 1.4
    assert float(hmc.effective_draws(apart)) < 100
