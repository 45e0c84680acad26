"""Coverage of prediction bands, counted by hand, and what an evaluation writes of them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from cases import Learned, drop, make_case

from ahnn.evaluation import evaluate
from ahnn.evaluation.bands import NORMAL, banded, norms
from ahnn.evaluation.forecast import right_bands
from ahnn.evaluation.forecast_variances import held, imagined
from ahnn.evaluation.independent_directions import DirectionTest, direction_test, ratio_interval
from ahnn.rollouts import rollout
from ahnn.uncertainty import Uncertainty

DOUBLE = {"dtype": torch.float64}


def known(sd, offset=0.0, inflation=1.0):
    return Uncertainty(
        torch.tensor([[sd]], **DOUBLE), torch.tensor([offset], **DOUBLE), inflation, {"determined": 1.0}
    )


def case_of(tmp_path, uncertainty, **changes):
    return make_case(tmp_path, flow=Learned(), uncertainty=uncertainty, **changes)


def prediction(case):
    return rollout(case.flow, case.test.states[:, 0], case.dt, case.test.states.shape[1])


@pytest.mark.parametrize(("sd", "expected"), [(0.02, (1, 1, 1)), (0.00667, (0, 1, 1)), (0.004, (0, 0, 1))])
def test_a_stiffness_that_is_off_by_some_deviations_is_covered_by_as_many(tmp_path, sd, expected):
    """One parameter: to first order every error is the same number of standard deviations, 0.01 / sd."""
    case = case_of(tmp_path, known(sd))
    band = banded(case, known(sd), prediction(case))
    assert [round(share, 1) for share in band.coverage] == list(expected)
    assert band.efficiency[0] == pytest.approx(0.01 / sd, rel=0.02)
    assert band.efficiency[1] == pytest.approx(0.01 / sd, rel=0.02)
    assert band.expected == pytest.approx(band.bound)


def test_the_bound_is_the_noise_alone_and_the_band_is_all_that_is_known(tmp_path):
    found = known(0.003, offset=0.004, inflation=4.0)
    case = case_of(tmp_path, found)
    band = banded(case, found, prediction(case))
    assert band.expected[0] == pytest.approx(band.bound[0] * 2 * 5 / 3, rel=1e-5)
    off = prediction(case) - case.test.states
    inside = (off.abs() <= 2 * band.deviations)[:, 1:].double().mean()
    assert band.coverage[1] == pytest.approx(float(inside))


@pytest.mark.parametrize(("remaining", "warned"), [(0.99, False), (1.01, True)])
def test_a_verdict_warns_of_a_training_that_ended_before_its_optimum(tmp_path, remaining, warned):
    """With one determined parameter, noise alone moves the optimum by one standard deviation."""
    found = replace(known(0.02), about={"determined": 1.0, "remaining": remaining})
    findings = evaluate(case_of(tmp_path, found), {}, figures=False)
    told = [line for line in findings.numbers["verdict"]["findings"] if "ended before its optimum" in line]
    assert len(told) == warned
    assert all(line in findings.faults and "loss.closing" in line for line in told)


def test_absent_samples_do_not_count(tmp_path):
    found = known(0.02)
    case = case_of(tmp_path, found)
    cut = torch.rand(case.test.times.shape, generator=torch.Generator().manual_seed(0)) < 0.5
    cut[:, 0] = False
    band = banded(drop(case, cut), found, prediction(case))
    assert band.coverage == (1, 1, 1)
    assert band.test.directions == 1
    assert all(math.isfinite(value) for value in (*band.expected, *band.bound, *band.efficiency))


def test_one_direction_refutes_bands_that_are_too_narrow_and_else_says_nothing(tmp_path):
    case = case_of(tmp_path, known(0.02))
    few, narrow = (banded(case, known(sd), prediction(case)).test for sd in (0.02, 0.004))
    assert (few.directions, few.verdict) == (1, "too few independent directions to tell")
    assert few.scatter == pytest.approx(0.5, rel=0.02)
    assert narrow.scatter == pytest.approx(2.5, rel=0.02)
    assert narrow.verdict == "too narrow"
    assert (
        few.sentence() == "errors along 1 independent directions are 0.50 standard deviations: " + few.verdict
    )


def drawn_errors(directions, rows, width):
    """Errors of 200 trainings as right bands have them, times a width, and the verdicts on them."""
    generator = torch.Generator().manual_seed(0)
    moved = torch.randn(rows, directions, generator=generator, **DOUBLE)
    moved *= 1 + 9 * torch.rand(rows, 1, generator=generator, **DOUBLE)
    errors = width * (moved @ torch.randn(directions, 200, generator=generator, **DOUBLE))
    return [direction_test([(one[:50], moved[:50]), (one[50:], moved[50:])]) for one in errors.mT]


@pytest.mark.parametrize(
    ("width", "verdict", "least"), [(1.0, "right", 0.9), (0.5, "too wide", 0.8), (2.0, "too narrow", 0.9)]
)
def test_errors_that_move_together_are_judged_by_as_many_directions_as_there_are(width, verdict, least):
    tests = drawn_errors(12, 4000, width)
    assert all(11 <= test.directions <= 12 for test in tests)
    assert sum(test.verdict == verdict for test in tests) >= least * len(tests)


def test_right_bands_are_refused_in_one_training_of_twenty():
    """200 trainings, by the binomial distribution 3 to 19 of them in 99.9 %."""
    assert 3 <= sum(test.verdict != "right" for test in drawn_errors(12, 400, 1.0)) <= 19


def test_the_interval_is_that_of_chi_square():
    assert DirectionTest(10, 1.0).right == pytest.approx(
        ((3.247 / 10) ** 0.5, (20.483 / 10) ** 0.5), rel=1e-4
    )
    assert DirectionTest(7, 0.2).verdict == "too few independent directions to tell"
    assert DirectionTest(8, 0.2).verdict == "too wide"


def test_the_ratio_of_error_and_bound_has_the_interval_of_its_directions():
    """Equal directions make it chi-square; beside one large direction others hardly count."""
    for count in (1, 12):
        low, high = ratio_interval(4.0 * torch.eye(count))
        expected = DirectionTest(count, 1.0).right
        assert low == pytest.approx(expected[0], rel=0.08)
        assert high == pytest.approx(expected[1], rel=0.03)
    one = ratio_interval(torch.diag(torch.tensor([1.0, *[1e-6] * 300])))
    assert one == pytest.approx(ratio_interval(torch.eye(1)), abs=0.02)


def test_errors_at_the_bound_are_in_that_interval_in_19_of_20_trainings():
    """Of 400, with the spectrum of a pendulum: 6 to 36 in 99.9 % of cases, by the binomial distribution."""
    sizes = torch.tensor([0.43, 0.13, 0.11, 0.07, *[0.02] * 13], **DOUBLE)
    low, high = ratio_interval(torch.diag(sizes))
    z = torch.randn(400, len(sizes), generator=torch.Generator().manual_seed(5), **DOUBLE)
    ratios = ((sizes * z.square()).sum(1) / sizes.sum()).sqrt()
    assert 6 <= int(((ratios < low) | (ratios > high)).sum()) <= 36
    assert low < 0.6
    assert float(ratios.median()) < 0.95


def test_forecasts_whose_right_bands_could_be_half_as_wide_are_not_judged():
    shares = (0.68, 0.95, 1.0)
    assert right_bands(shares, ((0.1, 1), (0.6, 1), (0.9, 1))) == "too few independent directions to tell"
    interval = ((0.6, 0.7), (0.94, 0.97), (0.98, 1))
    assert right_bands(shares, interval).endswith("19 of 20 draws: right")
    assert right_bands((0.5, 0.8, 0.9), interval).endswith("too narrow")
    assert right_bands((0.9, 0.99, 1.0), interval).endswith("too wide")


def test_right_bands_of_many_directions_hold_what_normal_errors_have():
    """The share of n independent errors scatters by sqrt(p (1 - p) / n)."""
    count = 2000
    shares = held(3.0 * imagined(count), torch.full((count, 1), 3.0)) / count
    for share, normal in zip(shares, NORMAL, strict=True):
        scatter = (normal * (1 - normal) / count) ** 0.5
        assert float(share.mean()) == pytest.approx(normal, abs=0.5 * scatter)
        assert float(share.std()) == pytest.approx(scatter, rel=0.25)


def test_norms_are_those_of_positions_and_velocities():
    values = torch.tensor([[[3.0, 4.0, 6.0, 8.0]], [[0.0, 0.0, 0.0, 0.0]]])
    assert norms(values, 2.0) == pytest.approx((5 / 2**0.5, 5 / 2**0.5))
    assert pytest.approx((0.6827, 0.9545, 0.9973), abs=1e-4) == NORMAL


def test_an_evaluation_tells_and_draws_the_band(tmp_path):
    findings = evaluate(case_of(tmp_path, known(0.02)), {})
    assert (
        findings.rows[0]
        .note.splitlines()[1]
        .startswith("bands of 1, 2 and 3 standard deviations contain 100, 100, 100 %")
    )
    assert "are 0.50 standard deviations: too few independent directions to tell)" in findings.rows[0].note
    assert "times the noise bound (0.03 to 2.2" in findings.rows[0].note
    (position, velocity) = findings.numbers["uncertainty"]["usual"]
    assert position == pytest.approx(DirectionTest(1, 1.0).right, abs=0.04)  # one parameter
    assert velocity == pytest.approx(position)
    assert findings.numbers["uncertainty"]["coverage"] == [1, 1, 1]
    assert findings.numbers["uncertainty"]["test"]["directions"] == 1
    assert findings.numbers["uncertainty"]["determined"] == 1.0
    assert "band" in findings.figures
    assert findings.arrays["true_start_deviations"].shape == findings.arrays["true_start"].shape
    without = evaluate(case_of(tmp_path, None), {}, figures=False)
    assert "uncertainty" not in without.numbers
    assert "band" not in evaluate(case_of(tmp_path, known(0.02)), {}, figures=False).figures
