"""Ratios of scores have the interval of Welch's test, and lost predictions are never taken for numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from ahnn_plugins.report.grid import as_printed, interval, mean_and_spread, shown
from ahnn_plugins.report.score_samples import Ratio, Sample, ratio

VALUES = st.lists(st.floats(1e-9, 1e9), min_size=2, max_size=6).filter(lambda v: max(v) > 1.001 * min(v))
INF, NAN = math.inf, math.nan


@settings(max_examples=60, deadline=None)
@given(VALUES, VALUES, st.sampled_from([0.8, 0.95, 0.99]))
def test_the_interval_is_that_of_welchs_test_on_logarithms(one, other, confidence):
    found = ratio(Sample(tuple(one)), Sample(tuple(other)), confidence)
    test = stats.ttest_ind(np.log(one), np.log(other), equal_var=False)
    limits = test.confidence_interval(confidence)
    assert math.log(found.value) == pytest.approx(np.mean(np.log(one)) - np.mean(np.log(other)), abs=1e-9)
    assert math.log(found.low) == pytest.approx(limits.low, rel=1e-7, abs=1e-9)
    assert math.log(found.high) == pytest.approx(limits.high, rel=1e-7, abs=1e-9)


def test_mean_and_spread_are_those_of_a_sample():
    found = Sample((1.0, 2.0, 4.0))
    assert found.mean == pytest.approx(7 / 3)
    assert found.spread == pytest.approx(np.std([1, 2, 4], ddof=1))
    assert found.typical == pytest.approx(2.0)
    assert Sample((3.0,)).spread is None


def test_one_run_has_no_interval_and_equal_runs_have_a_point():
    assert ratio(Sample((2.0,)), Sample((1.0, 1.0)), 0.95) == Ratio(2.0, 0.0, INF)
    assert ratio(Sample((2.0, 2.0)), Sample((1.0, 1.0)), 0.95) == Ratio(2.0, 2.0, 2.0)


def test_lost_predictions_decide_only_where_all_of_one_are_lost_and_none_of_the_other():
    fine, lost, some = Sample((1.0, 2.0)), Sample((INF, NAN)), Sample((1.0, INF))
    assert ratio(lost, fine, 0.95) == Ratio(INF, INF)
    assert ratio(lost, fine, 0.95).beyond(0, 1)
    assert ratio(fine, lost, 0.95).within(0, 1)
    for pair in ((some, fine), (fine, some), (lost, lost), (Sample(()), fine), (Sample((0.0, 1.0)), fine)):
        found = ratio(*pair, 0.95)
        assert math.isnan(found.value)
        assert not found.within(0, 1)
        assert not found.beyond(0, 1)
    assert not ratio(Sample((INF,)), Sample((1.0,)), 0.95).beyond(0, 1)


def test_within_and_beyond_are_about_the_whole_interval():
    assert Ratio(0.5, 0.4, 0.6).within(0.4, 0.6)
    assert not Ratio(0.5, 0.3, 0.6).within(0.4, 0.6)
    assert Ratio(0.5, 0.3, 0.6).beyond(0.61, 1)
    assert not Ratio(0.5, 0.3, 0.6).beyond(0.6, 1)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (None, "–"),
        (INF, "lost"),
        (NAN, "lost"),
        (1.5528, "1.55"),
        (9.996, "10.0"),
        (99999.0, "1.00×10⁵"),
        (12345.0, "12300"),
        (0.00123456, "0.00123"),
        (0.000123456, "1.23×10⁻⁴"),
        (-2.5e-12, "-2.50×10⁻¹²"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert shown(value) == text


def test_samples_and_ratios_are_written_with_what_is_known():
    assert mean_and_spread(Sample((1e-4, 1.2e-4)), 1e-4) == "1.10 ± 0.14"
    assert mean_and_spread(Sample((0.00643, 0.00656))) == "0.00649 ± 0.000092"
    assert mean_and_spread(Sample((2.0,))) == "2.00"
    assert mean_and_spread(Sample((1.0, INF, NAN))) == "lost in 2 of 3"
    assert mean_and_spread(Sample((INF,))) == "lost"
    assert mean_and_spread(Sample(())) == "–"
    assert interval(Ratio(2.0, 1.0, 4.0)) == "2.00 [1.00, 4.00]"
    assert interval(Ratio(2.0)) == "2.00"
    assert (interval(Ratio(INF)), interval(Ratio(NAN))) == ("∞", "–")
    assert (as_printed(91.73), as_printed(4.472e-5), as_printed(14374.0)) == ("91.73", "4.472×10⁻⁵", "14374")
