"""The forecasts of curves whose continuation is known by hand, beside the reference values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahnn_plugins.pfl.callback import PFLCallback
from ahnn_plugins.pfl.decision import Settings, checked, decide
from ahnn_plugins.pfl.predictor import log_linear, power_law, shifted_exponential
from ahnn_plugins.pfl.pruner import PFLPruner

POSITIVE = st.lists(st.floats(0.01, 100.0), min_size=3, max_size=30)


@pytest.mark.parametrize(
    ("losses", "target", "expected"),
    [
        # Five losses are not smoothed; drops of 2 over epochs 1 to 3, then 3: the slope -3 is halved.
        ([9.0, 8.0, 7.0, 6.0, 3.0], 10, 3.0 - 0.5 * 3.0 * 6),
        # Drops of 2, then a rise of 1: a slope of +1 is halved.
        ([9.0, 8.0, 7.0, 6.0, 7.0], 8, 7.0 + 0.5 * 1.0 * 4),
        # Four losses: epochs 1, 2 and 3; nothing drops first.
        ([5.0, 4.0, 4.0, 2.0], 5, 2.0 - 0.5 * 2.0 * 2),
        # Drops of 1 over epochs 1 to 3 and over 3 to 4 do not shrink; at the last epoch nothing is added.
        ([5.0, 4.0, 5.0, 3.0, 2.0], 4, 2.0),
    ],
)
def test_drops_that_do_not_shrink_go_on_at_half_the_last_slope(losses, target, expected):
    assert shifted_exponential(losses, target) == pytest.approx(expected, rel=1e-12)


def test_the_last_slope_is_per_epoch():
    # Nine losses, smoothed with weight 2/(3 + 1): points at epochs 3, 6 and 8.
    losses = [20.0, 19.5, 19.0, 18.0, 17.0, 15.0, 12.0, 8.0, 3.0]
    smooth = [losses[0]]
    for loss in losses[1:]:
        smooth.append(0.5 * loss + 0.5 * smooth[-1])
    expected = smooth[8] - 0.5 * (smooth[6] - smooth[8]) / 2 * (30 - 8)
    assert shifted_exponential(losses, 30) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("count", [4, 5])
@pytest.mark.parametrize("target", [5, 12, 50])
def test_an_exponential_that_is_not_smoothed_is_continued_through_its_points(count, target):
    # With four losses the points are equally spaced: the fit is the curve itself.
    losses = [2.0 * math.exp(-0.4 * t) + 0.7 for t in range(count)]
    i, j, k = (1, 2, 3) if count == 4 else (1, 3, 4)
    rate = -math.log((losses[j] - losses[k]) / (losses[i] - losses[j])) / (j - i)
    amplitude = (losses[i] - losses[j]) / (math.exp(-rate * i) - math.exp(-rate * j))
    expected = losses[j] + amplitude * (math.exp(-rate * target) - math.exp(-rate * j))
    assert shifted_exponential(losses, target) == pytest.approx(expected, rel=1e-10)
    if count == 4:
        assert expected == pytest.approx(2.0 * math.exp(-0.4 * target) + 0.7, rel=1e-10)


@pytest.mark.parametrize("count", [62, 90])
def test_the_smoothing_spans_a_third_of_the_curve_but_at_most_twenty_epochs(count):
    losses = [5.0 - 0.001 * t**1.5 for t in range(count)]
    span = 20
    smooth = [losses[0]]
    for loss in losses[1:]:
        smooth.append(2 / (span + 1) * loss + (1 - 2 / (span + 1)) * smooth[-1])
    i, j, k = count // 3, 2 * count // 3, count - 1
    assert smooth[j] - smooth[k] > smooth[i] - smooth[j]
    expected = smooth[k] - 0.5 * (smooth[j] - smooth[k]) / (k - j) * (120 - k)
    assert shifted_exponential(losses, 120) == pytest.approx(expected, rel=1e-11)


@given(losses=POSITIVE, target=st.integers(1, 60))
def test_lines_in_logarithms_are_those_of_numpy(losses, target):
    epochs, logs = np.arange(len(losses)), np.log(losses)
    for fit, x, at in (
        (log_linear, epochs, target),
        (power_law, np.log(epochs + 1.0), math.log(target)),
    ):
        slope, intercept = np.polyfit(x, logs, 1)
        assert math.log(fit(losses, target)) == pytest.approx(intercept + slope * at, rel=1e-8, abs=1e-8)


def test_the_fewest_losses_that_allow_a_forecast():
    assert log_linear([4.0, 2.0], 3) == pytest.approx(0.5, rel=1e-12)
    assert power_law([4.0, 2.0], 3) is None
    assert power_law([4.0, 2.0, 4.0 / 3.0], 8) == pytest.approx(0.5, rel=1e-12)
    assert shifted_exponential([4.0, 3.0, 2.5], 9) is None
    assert power_law([1e-10, 0.0, 1e-12], 7) == pytest.approx(1e-10, rel=1e-12)  # clipped


@pytest.mark.parametrize(
    ("own", "finals", "reason"),
    [
        ([[8.0, 4.0, 2.0]], [1.0, 1.0], "warm-up"),
        ([], [1.0, 1.0], "warm-up"),
        ([[8.0, 4.0, 2.0, 1.0]], [1.0], "too few models"),
        ([[8.0, 4.0, 2.0, 1.0]], [1.0, math.inf], "too few models"),
        ([[8.0, 4.0, 2.0, 1.0]], [9.0, 1 / 31, 1 / 64], "forecast within threshold"),
        ([[1.0] * 4], [9.0, 1.0, 0.5], "forecast within threshold"),
        ([[8.0, 4.0, 2.0, 1.0]], [9.0, 1 / 33, 1 / 64], "forecast above threshold"),
        ([[8.0, 4.0, 2.0, 1.0], [8.0, 4.0, 2.0, math.nan]], [1.0, 1.0], "non-finite loss"),
        ([[8.0, math.nan, 2.0, 1.0]], [1.0, 1.0], "no forecast"),
        ([[2.0**-t for t in range(8)]], [1.0, 1.0], "forecast within threshold"),
        ([[2.0**-t for t in range(9)]], [1.0, 1.0], "past target"),
    ],
)
def test_reasons_at_their_edges(own, finals, reason):
    # 8, 4, 2, 1 reaches 1/32 at epoch 8; the threshold is the second best.
    decision = decide(own, finals, Settings(fit_epochs=4, target_epoch=8, top_k=2))
    assert decision.reason == reason
    assert decision.prune == (reason in ("non-finite loss", "forecast above threshold"))


def test_the_forecast_of_several_seeds_is_their_mean():
    own = [[8.0, 4.0, 2.0, 1.0], [16.0, 8.0, 4.0, 2.0, 99.0]]
    decision = decide(own, [1.0], Settings(fit_epochs=4, target_epoch=6, top_k=1))
    assert decision.forecast == pytest.approx((8 / 64 + 16 / 64) / 2, rel=1e-12)


@pytest.mark.parametrize(("fit_epochs", "target", "fits"), [(4, 4, True), (3, 9, False), (6, 5, False)])
def test_counts_that_leave_nothing_to_forecast_are_refused(fit_epochs, target, fits):
    settings = Settings(fit_epochs=fit_epochs, target_epoch=target, top_k=1)
    if fits:
        assert checked(settings) is settings
        return
    with pytest.raises(
        Exception, match=r"fit_epochs: expected (int >= 4|at most target_epoch.* callbacks.pfl=null)"
    ):
        checked(settings)


def test_the_defaults_are_the_papers_everywhere(tmp_path):
    paper = Settings("log_linear", "first", 10, 50, 10)
    assert Settings() == paper
    assert PFLPruner(60).settings == paper
    assert PFLCallback(str(tmp_path)).settings == paper
