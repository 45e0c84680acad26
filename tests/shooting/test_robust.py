"""Pseudo-residuals: half their square is the loss, and their slopes are derivatives."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from torch.nn.functional import huber_loss

from ahnn.shooting.robust import FREEDOM, HUBER, ROBUST

E = torch.linspace(-60, 60, 4001, dtype=torch.float64)


def test_half_the_squares_are_the_losses():
    zero = torch.zeros_like(E)
    close(ROBUST["none"].pseudo(E) ** 2 / 2, E**2 / 2, 1e-15)
    close(ROBUST["huber"].pseudo(E) ** 2 / 2, huber_loss(E, zero, reduction="none", delta=HUBER), 1e-14)
    student = torch.distributions.StudentT(torch.tensor(FREEDOM, dtype=torch.float64))
    close(ROBUST["student"].pseudo(E) ** 2 / 2, student.log_prob(zero) - student.log_prob(E), 1e-13)


@pytest.mark.parametrize("name", list(ROBUST))
def test_slopes_are_derivatives_everywhere(name):
    e = torch.cat((E, torch.tensor([0.0, 1e-9, -1e-7], dtype=torch.float64))).requires_grad_()
    robust, step = ROBUST[name], 1e-5
    numeric = (robust.pseudo(e + step) - robust.pseudo(e - step)) / (2 * step)
    smooth = (e.abs() - HUBER).abs() > 2 * step
    close(robust.slope(e)[smooth], numeric[smooth], 1e-6)
    assert torch.equal(robust.pseudo(e).sign(), e.sign())
