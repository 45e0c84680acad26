"""NEES, bands and coverage against their definitions and laws."""

from __future__ import annotations

import pytest
import torch

from ahnn.estimation.consistency import band, coverage, nees, share_within

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
