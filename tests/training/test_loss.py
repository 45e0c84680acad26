"""Weights of residuals between one unit everywhere and the size of the local increment."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.errors import UserError
from ahnn.training import Loss, LossOptions
from ahnn.training.finite import require_finite_loss, require_finite_weights
from ahnn.training.loss import FLOOR

UNIT = torch.tensor([2.0, 4.0, 0.1, 0.5], dtype=torch.float64)


def loss(**options):
    made = Loss(4, LossOptions(**options)).double()
    made.unit.copy_(UNIT)
    return made


@pytest.mark.parametrize("balance", [0.3, 1.0])
def test_a_block_is_weighted_by_the_power_of_its_rms_increment(balance):
    targets = torch.randn(3, 5, 4, generator=generator(0), dtype=torch.float64)
    got = loss(balance=balance).weights(targets)
    for b in range(3):
        for k in range(5):
            for block in (slice(0, 2), slice(2, 4)):
                relative = targets[b, k, block] / UNIT[block]
                size = (float(relative.square().mean()) + FLOOR**2) ** 0.5
                close(got[b, k, block], size**-balance / UNIT[block], 1e-13)


def test_increments_below_the_floor_are_weighted_like_the_floor():
    still = loss(balance=1.0).weights(torch.zeros(1, 4, dtype=torch.float64))
    close(still, 1 / (0.03 * UNIT).unsqueeze(0), 1e-13)


@pytest.mark.parametrize("delta", [0.5, 2.0])
def test_the_loss_is_hubers(delta):
    residuals = torch.tensor([[0.1, -0.4, 1.0, -5.0]], dtype=torch.float64)
    size = residuals.abs()
    expected = torch.where(size <= delta, size**2 / 2, delta * (size - delta / 2)).mean()
    assert float(loss(delta=delta)(residuals)) == pytest.approx(float(expected), rel=1e-14)


@pytest.mark.parametrize(
    "options",
    [
        {"balance": 0.0, "derivative": 0.0, "order": 2},
        {"balance": 1.0, "derivative": 1.0, "delta": 1e-9},
        {"scale": "state"},
    ],
)
def test_the_ends_of_the_ranges_are_possible(options):
    assert LossOptions(**options).order in (2, 12)


@pytest.mark.parametrize(
    "options", [{"order": 0}, {"order": 1}, {"order": -2}, {"order": 7}, {"balance": 1.01}]
)
def test_what_lies_beyond_is_refused(options):
    with pytest.raises(UserError, match=f"^{next(iter(options))}: expected"):
        LossOptions(**options)


def test_numbers_that_are_not_finite_stop_a_training():
    module = torch.nn.Linear(2, 2)
    require_finite_loss(1e30, "here")
    require_finite_weights(module, "here")
    with pytest.raises(Exception, match="the loss became inf here"):
        require_finite_loss(float("inf"), "here")
    with torch.no_grad():
        module.bias[1] = torch.nan
    with pytest.raises(Exception, match="weights became nan or inf there"):
        require_finite_weights(module, "there")
