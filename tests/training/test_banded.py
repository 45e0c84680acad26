"""Whitening by blocks against the dense factor."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.training.banded import Factor

DOUBLE = {"dtype": torch.float64}


def banded(count, band, rows=3):
    lower = torch.randn(rows, 2, count, count, generator=generator(0), **DOUBLE).tril()
    lower = 0.2 * (lower - lower.tril(-band - 1))
    lower.diagonal(dim1=-2, dim2=-1).copy_(1 + torch.rand(count, generator=generator(1), **DOUBLE))
    return lower @ lower.mT, lower


@pytest.mark.parametrize(("count", "band"), [(50, 6), (16, 3), (17, 16), (100, 30), (5, 1)])
def test_blocks_whiten_as_the_whole_factor_does(count, band):
    matrix, lower = banded(count, band)
    sums = torch.randn(3, 2, count, 4, generator=generator(2), **DOUBLE)
    factor = Factor.of(matrix, band)
    close(factor.whiten(lower @ sums), sums, 1e-9)
    close(factor.whiten((lower @ sums).float()).double(), sums, 1e-3)
    got = factor.rows(slice(1, 2), 1).whiten((lower @ sums)[1:2, -1:])
    close(got, sums[1:2, -1:], 1e-9)


def test_one_matrix_serves_all():
    matrix, lower = banded(40, 6, rows=1)
    sums = torch.randn(3, 2, 40, 4, generator=generator(2), **DOUBLE)
    close(Factor.of(matrix, 6).rows(slice(0, 2), 2).whiten(lower @ sums), sums, 1e-9)
