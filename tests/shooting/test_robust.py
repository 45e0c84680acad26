"""Robust losses: what they are, and that their weights are their derivatives over the residual."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from torch.nn.functional import huber_loss

from ahnn.shooting.robust import FREEDOM, HUBER, ROBUST

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


@pytest.mark.parametrize("name", list(ROBUST))
def test_the_weighted_parabola_lies_above_the_loss(name):
    robust = ROBUST[name]
    at = E[::50].unsqueeze(-1)
    above = robust.cost(at) + robust.weight(at) * (E**2 - at**2)
    assert bool((above >= robust.cost(E) - 1e-9).all())
