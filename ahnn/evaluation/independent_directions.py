"""Test whether bands are as wide as errors, along independent directions, since errors in a run correlate.

Let W be the sensitivities of all states, in their standard deviations, to independent causes of variance 1.
If bands are calibrated, the errors are e = W eta with eta ~ N(0, I). Each eigenvector v of W^T W, with the
eigenvalue s^2, then gives an independent z = v^T W^T e / s^2 ~ N(0, 1), and the sum of z^2 over k directions
has a chi-square distribution.

The ratio of rms error and bound weights directions by their variance: with W in units of the state it is
(sum s^2 z^2 / sum s^2)^1/2. If few directions have most of the variance, this ratio scatters widely and is
below 1 in more than half of the training runs that attain the bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.numbers import chi_square_quantile

VARIANCE = 0.99
"""Fraction of the variance of the bands in the tested directions; the others hardly affect the bands."""
MIDDLE = 0.95
"""Fraction of training runs with calibrated bands that lie within the interval."""
TOO_FEW = "too few independent directions to tell"
"""Verdict if the interval for calibrated bands is too wide for a test."""
LEAST = 1e-4
"""Maximum fraction of the variance that the ratio of error and bound omits."""
HALF = 0.5
"""If the interval begins below this value, bands of twice the correct width would pass the test."""


DRAWS = 20_000
"""Draws of independent directions for the ratio of error and bound."""


class DirectionTest(NamedTuple):
    """Errors along the independent directions of bands.

    Attributes:
        directions: number k of directions.
        scatter: rms of the errors along them, in standard deviations.
    """

    directions: int
    scatter: float

    @property
    def right(self) -> tuple[float, float]:
        """Interval of the scatter in the middle 95 % of training runs with calibrated bands."""
        low, high = (chi_square_quantile((1 + sign * MIDDLE) / 2, self.directions) for sign in (-1, 1))
        return (low / self.directions) ** 0.5, (high / self.directions) ** 0.5

    @property
    def verdict(self) -> str:
        """Return a verdict on the bands from the scatter: right, too wide, too narrow, or undecided."""
        low, high = self.right
        if self.scatter > high:
            return "too narrow"
        if low < HALF:
            return TOO_FEW
        return "too wide" if self.scatter < low else "right"

    def sentence(self) -> str:
        """Return the finding in words."""
        low, high = self.right
        found = (
            f"errors along {self.directions} independent directions are {self.scatter:.2f} standard "
            "deviations"
        )
        if self.verdict == TOO_FEW:
            return f"{found}: {self.verdict}"
        return (
            f"{found}, with calibrated bands {low:.2f} to {high:.2f} in 19 of 20 training runs: "
            f"{self.verdict}"
        )

    def numbers(self) -> dict[str, object]:
        """Return plain values for metrics.json."""
        return {**self._asdict(), "right": list(self.right), "verdict": self.verdict}


def direction_test(parts: Iterable[tuple[Tensor, Tensor]]) -> DirectionTest:
    """Test errors (N,) against sensitivities (N, R) in the same unit, given in parts."""
    matrix, pull = torch.zeros(()), torch.zeros(())
    for errors, moved in parts:
        sd = moved.norm(dim=-1, keepdim=True)
        seen = (sd > 0).squeeze(-1) & sd.isfinite().squeeze(-1)
        rows = moved[seen] / sd[seen]
        matrix = matrix + (rows.mT @ rows).double()
        pull = pull + (rows.mT @ (errors[seen] / sd[seen].squeeze(-1)).to(rows)).double()
    return scatter_of(matrix, pull)


def ratio_interval(matrix: Tensor) -> tuple[float, float]:
    """Return the central 95 % range of rms error over bound, for runs at the bound, from W^T W, (R, R)."""
    ends = torch.tensor([(1 - MIDDLE) / 2, (1 + MIDDLE) / 2], dtype=torch.float64)
    low, high = torch.quantile(ratio_draws(matrix), ends).tolist()
    return low, high


def ratio_draws(matrix: Tensor) -> Tensor:
    """Return `DRAWS` ratios of rms error and bound for runs at the bound, from W^T W, shape (R, R)."""
    sizes = torch.linalg.eigvalsh(matrix.double()).clamp(min=0)
    parts = sizes / sizes.sum()
    squares = torch.zeros(DRAWS, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    for part in parts[parts > LEAST / len(parts)]:
        squares += part * torch.randn(DRAWS, generator=generator, dtype=torch.float64).square()
    return squares.sqrt()


def together(tests: Sequence[DirectionTest]) -> DirectionTest:
    """Combine the tests of several independent training runs into one."""
    count = sum(test.directions for test in tests)
    squares = sum(test.directions * test.scatter**2 for test in tests)
    return DirectionTest(count, (squares / count) ** 0.5)


def scatter_of(matrix: Tensor, pull: Tensor) -> DirectionTest:
    """Return the test from W^T W, shape (R, R), and W^T e, shape (R,)."""
    sizes, vectors = torch.linalg.eigh(matrix)
    sizes, vectors = sizes.flip(0), vectors.flip(1)
    count = 1 + int((sizes.cumsum(0) < VARIANCE * sizes.sum()).sum())
    along = (vectors.mT @ pull)[:count] / sizes[:count]
    return DirectionTest(count, float(along.square().mean().sqrt()))
