"""The rule: what prunes, what does not, and that no curve raises."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ahnn_plugins.pfl.decision import Settings, checked, decide
from ahnn_plugins.pfl.predictor import log_linear

FINALS = [0.1 * k for k in range(1, 13)]  # the tenth best is 1.0
FALLING = [2.0**-t for t in range(10)]
FLAT = [1.5] * 10


def test_worse_than_the_tenth_best_is_pruned():
    decision = decide([FLAT], FINALS, Settings())
    assert decision.prune
    assert decision.forecast == pytest.approx(1.5)
    assert decision.threshold == pytest.approx(1.0)


def test_better_is_kept():
    decision = decide([FALLING], FINALS, Settings())
    assert decision[::3] == (False, "forecast within threshold")
    assert decision.forecast == pytest.approx(2.0**-50, rel=1e-9)


@pytest.mark.parametrize("finals", [[], FINALS[:9], [*FINALS[:9], math.nan, math.inf]])
def test_fewer_than_top_k_prune_nothing(finals: list[float]):
    assert decide([FLAT], finals, Settings())[::3] == (False, "too few models")


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_non_finite_loss_prunes_at_once(bad: float):
    assert decide([[bad]], [], Settings()).prune
    assert decide([FALLING, [1.0, bad]], FINALS, Settings()).reason == "non-finite loss"


def test_warm_up_restarts_with_every_seed():
    assert decide([FLAT, FLAT[:9]], FINALS, Settings())[::3] == (False, "warm-up")
    assert decide([FLAT, FLAT], FINALS, Settings()).prune


def test_seeds_are_averaged():
    low, high = [0.2] * 10, [2.0] * 10
    assert decide([low, high], FINALS, Settings()).forecast == pytest.approx(1.1)


def test_first_ignores_later_losses_and_all_uses_them():
    losses = [*FALLING, *[2.0] * 5]
    assert decide([losses], FINALS, Settings()).forecast == pytest.approx(2.0**-50, rel=1e-9)
    assert decide([losses], FINALS, Settings(use="all")).forecast == log_linear(losses, 50)


def test_a_run_beyond_the_target_is_left_alone():
    assert decide([[1.5] * 51], FINALS, Settings()).reason == "past target"


def test_zero_loss_is_no_reason_to_prune():
    assert decide([[0.0] * 10], FINALS, Settings()).reason == "no forecast"


@pytest.mark.parametrize(
    "wrong", [{"fit": "cubic"}, {"use": "last"}, {"fit_epochs": 60}, {"fit_epochs": 1}, {"top_k": 0}]
)
def test_wrong_settings_name_what_is_expected(wrong: dict):
    with pytest.raises(ValueError, match=r"^(fit|use|fit_epochs|top_k): expected"):
        checked(Settings(**wrong))


def test_ten_thousand_random_curves():
    rng = np.random.default_rng(7)
    kinds = (
        lambda n: np.full(n, rng.lognormal()),
        lambda n: np.exp(rng.normal(0, 3) * np.arange(n)),
        lambda n: 1 + np.sin(rng.uniform(0, 3) * np.arange(n)),
        lambda n: rng.lognormal(0, 5, n),
        lambda n: np.where(rng.random(n) < 0.1, np.nan, rng.random(n)),
        lambda n: rng.normal(size=n),
    )
    variants = [
        Settings(fit=fit, use=use)
        for fit in ("log_linear", "shifted", "power_law")
        for use in ("first", "all")
    ]
    for index in range(10_000):
        with np.errstate(over="ignore"):
            losses = kinds[index % len(kinds)](int(rng.integers(0, 60))).tolist()
        decision = decide([losses], FINALS, variants[index % 7 % 6])
        assert decision.forecast is None or math.isfinite(decision.forecast)
        if len(losses) < 10:
            assert not decision.prune or not math.isfinite(losses[-1])
