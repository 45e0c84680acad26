"""Whitening by blocks against the dense factor."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.training.banded import BandedFactor

DOUBLE = {"dtype": torch.float64}


def banded(count, band, size, rows=3):
    """A lower triangle of so many diagonals of blocks, and its square as bands."""
    total = count * size
    lower = torch.randn(rows, total, total, generator=generator(0), **DOUBLE).tril()
    lower = 0.2 * (lower - lower.tril(-(band - 1) * size - 1))
    lower.diagonal(dim1=-2, dim2=-1).copy_(1 + torch.rand(total, generator=generator(1), **DOUBLE))
    matrix = (lower @ lower.mT).unflatten(2, (count, size)).unflatten(1, (count, size)).transpose(2, 3)
    index = torch.arange(count)
    bands = [matrix[:, index[d:], index[: count - d]] for d in range(band + 1)]
    return bands, lower


@pytest.mark.parametrize(
    ("count", "band", "size"), [(50, 6, 1), (16, 3, 2), (17, 16, 1), (23, 6, 6), (5, 1, 4), (3, 1, 2)]
)
def test_blocks_whiten_as_the_whole_factor_does(count, band, size):
    bands, lower = banded(count, band, size)
    sums = torch.randn(3, count * size, 4, generator=generator(2), **DOUBLE)
    colored = (lower @ sums).unflatten(1, (count, size))
    white = sums.unflatten(1, (count, size))
    factor = BandedFactor.of(bands)
    close(factor.whiten(colored), white, 1e-9)
    close(factor.whiten(colored.float()).double(), white, 1e-3)
    close(factor.rows(slice(1, 2)).whiten(colored[1:2]), white[1:2], 1e-9)
    parts = [BandedFactor.of([band[some] for band in bands]) for some in (slice(2), slice(2, 3))]
    close(BandedFactor.joined(parts).whiten(colored), white, 1e-9)
