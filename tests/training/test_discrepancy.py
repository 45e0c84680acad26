"""The relative error of a field, read off residuals of known origin."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from scipy.stats import norm

from ahnn.training.discrepancy import relative_error

DOUBLE = {"dtype": torch.float64}
SHAPE = (50, 400)


def drawn(e, seed=0):
    """Residuals of sums whose field has the relative error e, what it contributes and their noise."""
    one, two, three = (torch.randn(*SHAPE, 3, generator=generator(seed + k), **DOUBLE) for k in range(3))
    effects, noise = 1e6 * one.square(), 0.5 + two.square()
    return three * (noise + e * e * effects).sqrt(), effects, noise


@pytest.mark.parametrize("e", [1e-1, 1e-2, 1e-3])
def test_a_share_is_found(e):
    there = torch.ones(1, SHAPE[1], dtype=torch.bool)
    got = relative_error(*drawn(e), there)
    assert abs(got / e - 1) < 0.15


def test_noise_alone_is_no_share():
    residuals, effects, noise = drawn(0.0)
    there = torch.ones(*SHAPE, dtype=torch.bool)
    assert relative_error(0.9 * residuals, effects, noise, there) == 0.0


def test_sums_that_are_missing_say_nothing():
    residuals, effects, noise = drawn(1e-2)
    there = torch.ones(*SHAPE, dtype=torch.bool)
    there[:, ::3] = False
    kept = there[0]
    whole = relative_error(*(of[:, kept] for of in (residuals, effects, noise, there)))
    residuals[:, ::3] = 1e9
    close(torch.tensor(relative_error(residuals, effects, noise, there)), torch.tensor(whole), 1e-9)
    assert relative_error(residuals, effects, noise, torch.zeros_like(there)) == 0.0


def test_outliers_hardly_count():
    residuals, effects, noise = drawn(1e-2)
    residuals[torch.rand(residuals.shape, generator=generator(9)) < 0.05] *= 50
    got = relative_error(residuals, effects, noise, torch.ones(*SHAPE, dtype=torch.bool))
    assert abs(got / 1e-2 - 1) < 0.1


@pytest.mark.parametrize("e", [1e-3, 1.0])
def test_with_it_half_of_the_residuals_are_as_large_as_half_of_normal_numbers(e):
    residuals, effects, noise = drawn(e)
    got = relative_error(residuals, effects, noise, torch.ones(*SHAPE, dtype=torch.bool))
    median = float((residuals.abs() / (noise + got**2 * effects).sqrt()).median())
    assert median == pytest.approx(norm.ppf(0.75), rel=1e-4)
