"""The forecasts equal the reference values of facts.md 2.4, and no curve breaks them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn_plugins.pfl.predictor import FITS, log_linear, power_law, shifted_exponential

HALVING = [2.0**-t for t in range(10)]
HYPERBOLA = [1 / (t + 1) for t in range(10)]
FLOOR = [0.9 * math.exp(-0.3 * t) + 0.1 for t in range(11)]


@pytest.mark.parametrize(
    ("losses", "expected"),
    [
        (HALVING, 2.0**-50),
        (HYPERBOLA, 6.18149208505800e-06),
        (FLOOR[:10], 3.19166978374e-05),
        (FLOOR, 5.08817798432e-05),
    ],
)
def test_log_linear_reference(losses: list[float], expected: float):
    assert log_linear(losses, 50) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("losses", "expected", "digits"),
    [(HALVING, 6.36310e-05, 1e-6), (HYPERBOLA, 0.02, 1e-9), (FLOOR[:10], 4.874830e-02, 1e-6)],
)
def test_power_law_reference(losses: list[float], expected: float, digits: float):
    assert power_law(losses, 50) == pytest.approx(expected, rel=digits)  # as many digits as facts.md prints


@pytest.mark.parametrize(
    ("losses", "expected", "digits"),
    [
        (HALVING, -2.770936e-03, 1e-6),
        (HYPERBOLA, 8.0480423e-02, 1e-8),
        (FLOOR[:10], 8.2213401e-02, 1e-8),
        (FLOOR, 1.28890141e-01, 1e-8),
    ],
)
def test_shifted_reference(losses: list[float], expected: float, digits: float):
    assert shifted_exponential(losses, 50) == pytest.approx(expected, rel=digits)


@pytest.mark.parametrize("fit", FITS.values(), ids=FITS)
@pytest.mark.parametrize(
    "losses",
    [[], [1.0], [1.0, math.nan, 0.5], [math.inf] * 10, [-1.0] * 10, [0.0] * 10, [1e308] * 10, [5e-324] * 10],
    ids=["empty", "one", "nan", "inf", "negative", "zero", "huge", "tiny"],
)
def test_odd_curves_give_a_finite_forecast_or_none(fit, losses: list[float]):
    forecast = fit(losses, 50)
    assert forecast is None or math.isfinite(forecast)


@pytest.mark.parametrize("name", FITS)
def test_flat_curve_is_forecast_flat(name: str):
    assert FITS[name]([0.25] * 10, 50) == pytest.approx(0.25, rel=1e-12)


@settings(max_examples=1000, deadline=None)
@given(st.lists(st.floats(), max_size=30), st.integers(1, 500))
def test_any_floats(losses: list[float], target: int):
    for fit in FITS.values():
        forecast = fit(losses, target)
        assert forecast is None or math.isfinite(forecast)
