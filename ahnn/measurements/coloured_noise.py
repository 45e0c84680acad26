"""Whitening of first-order coloured plus white noise, for measurements at arbitrary times.

The noise of a component, in its standard deviations, is w + c: white noise of variance 1 - f, and first-order
Gauss-Markov noise of variance f, with correlation exp(-t / memory) (Tapley, Schutz & Born 2004, section 4.9).
Filters estimate c as additional states (`ahnn.estimation.sensor_error`). A scalar Kalman filter of c in each
row turns coloured residuals into white ones: its innovations, divided by their standard deviations. Its gains
depend only on times, so that whitening is a linear map, lower triangular in time.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Colour(NamedTuple):
    """Coloured part of the noise of M measured components.

    Attributes:
        fractions: (M,) fractions f of the variance, from 0 to 1.
        memories: (M,) time constants, in the unit of time.
    """

    fractions: Tensor
    memories: Tensor


class Whitening(NamedTuple):
    """Map from residuals with coloured noise to residuals with white noise, (B, T, M) each.

    Attributes:
        kept: fraction of the coloured part that remains from the previous time.
        gain: gain of the filter, 0 where nothing was measured.
        scale: 1 over the standard deviation of an innovation, 0 where nothing was measured.
    """

    kept: Tensor
    gain: Tensor
    scale: Tensor

    @classmethod
    def of(cls, colour: Colour, times: Tensor, there: Tensor) -> Whitening:
        """Return the map for rows at times (B, T); `there` is the mask of measured values, (B, T, M)."""
        fractions, memories = (part.to(times) for part in colour)
        gaps = torch.nn.functional.pad(times.diff(dim=1), (1, 0))
        kept = (-gaps.unsqueeze(-1) / memories).exp()
        variance, gains, scales = fractions.expand_as(kept[:, 0]), [], []
        for left, seen in zip(kept.unbind(1), there.unbind(1), strict=True):
            variance = left**2 * variance + (1 - left**2) * fractions
            total = variance + 1 - fractions
            gains.append(torch.where(seen, variance / total, 0.0))
            scales.append(torch.where(seen, total.rsqrt(), 0.0))
            variance = variance * (1 - gains[-1])
        return cls(kept, torch.stack(gains, dim=1), torch.stack(scales, dim=1))

    def __call__(self, rows: Tensor) -> Tensor:
        """Return whitened rows (B, T, M, ...); missing values become 0."""
        kept, gain, scale = (_widened(part, rows) for part in self)
        coloured, found = torch.zeros_like(rows[:, 0]), []
        for k, row in enumerate(rows.unbind(1)):
            coloured = kept[:, k] * coloured
            innovation = row - coloured
            coloured = coloured + gain[:, k] * innovation
            found.append(scale[:, k] * innovation)
        return torch.stack(found, dim=1)

    def transposed(self, rows: Tensor) -> Tensor:
        """Return the transpose of the map applied to rows (B, T, M, ...)."""
        kept, gain, scale = (_widened(part, rows) for part in self)
        pull, found = torch.zeros_like(rows[:, 0]), []
        for k in reversed(range(rows.shape[1])):
            of_innovation = scale[:, k] * rows[:, k] + gain[:, k] * pull
            pull = kept[:, k] * (pull - of_innovation)
            found.append(of_innovation)
        return torch.stack(found[::-1], dim=1)

    @property
    def log_determinant(self) -> Tensor:
        """Logarithm of the determinant of the correlation matrix of each row, (B,)."""
        return -2 * self.scale.where(self.scale > 0, 1.0).log().sum((1, 2))


def _widened(part: Tensor, rows: Tensor) -> Tensor:
    """Reshape (B, T, M) to as many dimensions as `rows`."""
    return part.to(rows).reshape(*part.shape, *[1] * (rows.ndim - part.ndim))
