"""Robust losses: what they are, and that their weights are their derivatives over the residual."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from torch.nn.functional import huber_loss

from ahnn.shooting.robust import FREEDOM, HUBER, ROBUST, variance

E = torch.linspace(-60, 60, 4001, dtype=torch.float64)


def test_half_the_costs_are_the_losses():
    zero = torch.zeros_like(E)
    close(ROBUST["none"].cost(E) / 2, E**2 / 2, 1e-15)
    close(ROBUST["huber"].cost(E) / 2, huber_loss(E, zero, reduction="none", delta=HUBER), 1e-14)
    student = torch.distributions.StudentT(torch.tensor(FREEDOM, dtype=torch.float64))
    close(ROBUST["student"].cost(E) / 2, student.log_prob(zero) - student.log_prob(E), 1e-13)


@pytest.mark.parametrize("name", list(ROBUST))
def test_weights_are_derivatives_over_residuals(name):
    e = torch.cat((E, torch.tensor([1e-9, -1e-7], dtype=torch.float64))).requires_grad_()
    robust = ROBUST[name]
    (slope,) = torch.autograd.grad(robust.cost(e).sum(), e)
    close(robust.weight(e) * e, slope / 2, 1e-14)
    assert float(robust.weight(torch.zeros(1))) > 0
    (bend,) = torch.autograd.grad((robust.weight(e) * e).sum(), e)
    close(robust.slope(e.detach()), bend, 1e-13)


@pytest.mark.parametrize("outliers", [0.0, 0.05])
@pytest.mark.parametrize("name", list(ROBUST))
def test_the_variance_is_that_of_repeated_experiments(name, outliers):
    """Of 6,000 fits of one number to 200, each by reweighting from the truth; sd of their variance 2 %."""
    robust, rng = ROBUST[name], generator(0)
    noise = torch.randn(6000, 200, generator=rng, dtype=torch.float64)
    noise[torch.rand(noise.shape, generator=rng) < outliers] *= 20
    fitted = torch.zeros(6000, 1, dtype=torch.float64)
    for _ in range(30):
        weight = robust.weight(noise - fitted)
        fitted = (weight * noise).sum(1, keepdim=True) / weight.sum(1, keepdim=True)
    found = []
    for e in (noise - fitted)[:200]:
        found.append(variance(robust, e) * robust.cost(e).mean() / robust.weight(e).sum())
    expected = float(fitted.square().mean())
    assert float(torch.stack(found).mean()) == pytest.approx(expected, rel=0.08)


def test_the_variance_of_squares_is_their_mean_and_leaves_out_what_was_not_measured():
    e = torch.tensor([0.3, -2.0, 0.0, 1.1, 0.0], dtype=torch.float64)
    assert variance(ROBUST["none"], e) == pytest.approx(1.0, rel=1e-14)
    assert variance(ROBUST["student"], e) == pytest.approx(variance(ROBUST["student"], e[e != 0]), rel=1e-14)


@pytest.mark.parametrize("name", list(ROBUST))
def test_the_weighted_parabola_lies_above_the_loss(name):
    robust = ROBUST[name]
    at = E[::50].unsqueeze(-1)
    above = robust.cost(at) + robust.weight(at) * (E**2 - at**2)
    assert bool((above >= robust.cost(E) - 1e-9).all())
