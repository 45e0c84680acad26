"""NEES, bands and coverage against their definitions and laws."""

from __future__ import annotations

import math

import pytest
import scipy.stats
import torch

from ahnn.estimation.consistency import (
    GAUSSIAN,
    band,
    correlation_time,
    coverage,
    independent_count,
    nees,
    share_within,
)
from ahnn.estimation.consistency_bands import Judged, nis_at_times
from ahnn.numbers import chi_square_quantile

F64 = torch.float64


def test_nees_is_the_quadratic_form() -> None:
    generator = torch.Generator().manual_seed(0)
    chol = torch.randn(2, 3, 4, 4, generator=generator, dtype=torch.float64).tril() + 3 * torch.eye(4)
    error = torch.randn(2, 3, 4, generator=generator, dtype=torch.float64)
    expected = torch.einsum("bti,btij,btj->bt", error, torch.linalg.inv(chol @ chol.mT), error)
    torch.testing.assert_close(nees(error, chol), expected, rtol=1e-12, atol=0)


def test_band_holds_95_percent_of_gaussian_means() -> None:
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(20_000, 10, 6, generator=generator).square().sum(-1).mean(-1)
    assert share_within(means, band(6, 10)) == pytest.approx(0.95, abs=0.006)


def test_coverage_of_gaussian_errors_leaves_out_what_is_missing() -> None:
    error = 2 * torch.randn(1, 100_000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    error[:, :50_000, 0] = torch.nan
    shares = coverage(error, torch.full_like(error, 2.0))
    assert [shares[k] for k in (1, 2, 3)] == pytest.approx([0.6827, 0.9545, 0.9973], abs=0.004)


def correlated(members, steps, phi, seed):
    """NEES of errors with two components that follow an autoregression of order one."""
    generator = torch.Generator().manual_seed(seed)
    error = torch.randn(members, 2, generator=generator, dtype=F64)
    values = []
    for _ in range(steps):
        values.append(error.square().sum(-1))
        noise = torch.randn(members, 2, generator=generator, dtype=F64)
        error = phi * error + (1.0 - phi**2) ** 0.5 * noise
    return torch.stack(values, 1)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.98])
def test_independent_count_of_a_known_autocorrelation(phi):
    # The squares of such errors have the autocorrelation phi^2k, with the sum 1 + 2 sum = (1 + a)/(1 - a).
    members, steps = 400, 500
    count = independent_count(correlated(members, steps, phi, seed=1))
    exact = members * steps * (1.0 - phi**2) / (1.0 + phi**2)
    assert count == pytest.approx(exact, rel=0.15)


def test_single_times_and_missing_values_have_no_correlation_time():
    for values in (torch.tensor([[1.0], [2.0]], dtype=F64), torch.full((2, 5), torch.nan, dtype=F64)):
        assert correlation_time(values) is None


def test_missing_values_count_nothing():
    values = correlated(300, 400, 0.8, seed=2)
    padded = torch.cat((values, torch.full((300, 700), torch.nan, dtype=F64)), dim=1)
    assert independent_count(padded) == pytest.approx(independent_count(values), rel=0.02)
    assert independent_count(torch.full((3, 5), torch.nan, dtype=F64)) == 0.0
    assert independent_count(values[:, :1]) == 300.0


def test_a_constant_of_each_member_is_worth_one_value_each():
    values = correlated(50, 1, 0.0, seed=3).expand(50, 200)
    assert independent_count(values) == pytest.approx(50.0, rel=0.05)


def test_the_band_of_the_mean_nees_holds_and_that_of_one_time_is_too_wide():
    runs, members, steps = 300, 8, 400
    inside, lenient = 0, 0
    for seed in range(runs):
        values = correlated(members, steps, 0.8, seed)
        low, high = band(2, independent_count(values))
        inside += low <= float(values.mean()) <= high
        low, high = band(2, members)
        lenient += low <= float(values.mean()) <= high
    # 300 runs know a share of 0.95 to 0.013.
    assert inside / runs == pytest.approx(0.95, abs=0.04)
    assert lenient == runs


def test_the_band_of_rows_with_different_numbers_of_components():
    generator = torch.Generator().manual_seed(0)
    sizes = torch.tensor([1, 3, 3, 2, 4])
    squares = torch.randn(20_000, int(sizes.sum()), generator=generator).square()
    means = squares.sum(-1) / len(sizes)
    assert share_within(means, band(float(sizes.double().mean()), len(sizes))) == pytest.approx(
        0.95, abs=0.006
    )


def naive_count(values):
    """Loops over lags, members and times, as the docstring of `independent_count` has it."""
    rows = [[float(v) for v in row] for row in values]
    known = [v for row in rows for v in row if v == v]
    members = sum(any(v == v for v in row) for row in rows)
    mean, steps = sum(known) / len(known), values.shape[1]
    covariances = []
    for lag in range(steps):
        products = [
            (row[k] - mean) * (row[k + lag] - mean)
            for row in rows
            for k in range(steps - lag)
            if row[k] == row[k] and row[k + lag] == row[k + lag]
        ]
        covariances.append(sum(products) / len(products) if products else 0.0)
    time = -1.0
    for lag in range(0, steps - 1, 2):
        pair = sum(covariances[i] / covariances[0] * (1 - i / steps) for i in (lag, lag + 1))
        if pair <= 0:
            break
        time += 2 * pair
    return min(max(len(known) / max(time, 1.0), members), len(known))


@pytest.mark.parametrize("steps", [2, 3, 9, 20])
@pytest.mark.parametrize("seed", range(4))
def test_independent_count_equals_a_loop_over_all_lags(steps, seed):
    values = correlated(6, steps, 0.9, seed)
    generator = torch.Generator().manual_seed(seed)
    gaps = torch.rand(values.shape, generator=generator) < 0.3
    gaps[:, 0] = False
    gapped = values.masked_fill(gaps, torch.nan)
    if steps > 3:
        gapped[:, steps // 2 :] = torch.nan  # no member has the long lags twice
        gapped[0, steps - 1] = 9.0
    for case in (values, gapped):
        assert independent_count(case) == pytest.approx(naive_count(case), rel=1e-9)
    assert independent_count(values) > 6


def test_the_probabilities_of_a_gaussian_and_what_lies_on_an_edge():
    assert {k: math.erf(k / math.sqrt(2)) for k in (1, 2, 3)} == pytest.approx(GAUSSIAN, rel=1e-14)
    error = torch.tensor([[[1.0, -2.0, 3.0, 4.0]]], dtype=F64)
    assert coverage(error, torch.ones_like(error)) == {1: 0.25, 2: 0.5, 3: 0.75}
    assert share_within(torch.tensor([1.0, 2.0, 3.0, 4.0]), (1.0, 3.0)) == 0.75


@pytest.mark.parametrize("degrees", [1, 2, 6.5, 100, 250_000])
@pytest.mark.parametrize("probability", [0.025, 0.5, 0.9999])
def test_quantiles_are_those_of_scipy(degrees, probability):
    expected = scipy.stats.chi2.ppf(probability, degrees)
    assert chi_square_quantile(probability, degrees) == pytest.approx(expected, rel=1e-12)


def test_a_mean_that_an_exact_start_makes_low_is_no_finding():
    low, right, high = (Judged(mean, (1.5, 2.5)) for mean in (1.0, 2.0, 3.0))
    assert low.of_exact_starts() == "1 below 1.5 to 2.5"
    assert str(low) == "1 not in 1.5 to 2.5"
    assert right.of_exact_starts() == str(right) == "2 in 1.5 to 2.5"
    assert high.of_exact_starts() == "3 not in 1.5 to 2.5"


def test_the_nis_of_sensors_that_see_a_part_is_judged_by_what_they_measured():
    """Against sums of squares and quantiles of scipy.stats."""
    values = torch.tensor([[3.0, torch.nan, 8.0], [5.0, torch.nan, torch.nan]], dtype=torch.float64)
    measured = torch.tensor([[3, 2, 6], [1, 3, 0]])
    ratio, low, high = nis_at_times(values, measured)
    assert ratio.tolist()[::2] == pytest.approx([8 / 4, 8 / 6])
    for k, count in ((0, 4), (2, 6)):
        expected = scipy.stats.chi2.ppf([0.025, 0.975], count) / count
        assert [float(low[k]), float(high[k])] == pytest.approx(expected.tolist(), rel=1e-10)
    assert bool(torch.stack((ratio, low, high))[:, 1].isnan().all())
