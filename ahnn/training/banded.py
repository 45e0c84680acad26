"""Banded covariances of sums, each of which overlaps only with its neighbours, and their cheap whitening."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

ROWS = 16
"""Minimum number of sums in a block."""


class BandedFactor(NamedTuple):
    """Cholesky factor L of the covariances of J sums of D components, in blocks of neighbouring sums.

    Attributes:
        diagonal: the blocks L_kk, (B, N, R, R), R / D sums each; the last one may contain fewer.
        below: the blocks L_k,k-1 to the left of these, (B, N, R, R); zero for the first.
    """

    diagonal: Tensor
    below: Tensor

    @classmethod
    def of(cls, bands: Sequence[Tensor]) -> BandedFactor:
        """Factor positive definite covariances.

        Args:
            bands: for each distance d >= 0, the covariances (B, J - d, D, D) between sums j + d (rows) and
                sums j (columns); more distant sums are independent.
        """
        diagonal, left = (blocks.unbind(1) for blocks in _blocks(bands))
        factors, below = [torch.linalg.cholesky(diagonal[0])], [left[0]]
        for own, beside in zip(diagonal[1:], left[1:], strict=True):
            below.append(torch.linalg.solve_triangular(factors[-1], beside.mT, upper=False).mT)
            factors.append(torch.linalg.cholesky(own - below[-1] @ below[-1].mT))
        return cls(torch.stack(factors, 1), torch.stack(below, 1))

    @classmethod
    def joined(cls, parts: Sequence[BandedFactor]) -> BandedFactor:
        """Concatenate the factors of several batches."""
        return cls(*(torch.cat(blocks) for blocks in zip(*parts, strict=True)))

    def whiten(self, sums: Tensor) -> Tensor:
        """Return L^-1 s of sums (B, J, D, M) whose covariance is L L^T, in the precision of s."""
        blocks, rows = self.diagonal.shape[1:3]
        flat = sums.flatten(1, 2)
        missing = blocks * rows - flat.shape[1]
        parts = torch.nn.functional.pad(flat, (0, 0, 0, missing)).unflatten(1, (blocks, rows)).unbind(1)
        diagonal, below = (of.to(sums).unbind(1) for of in self)
        done = [torch.linalg.solve_triangular(diagonal[0], parts[0], upper=False)]
        for own, beside, part in zip(diagonal[1:], below[1:], parts[1:], strict=True):
            done.append(torch.linalg.solve_triangular(own, part - beside @ done[-1], upper=False))
        return torch.cat(done, dim=1)[:, : flat.shape[1]].unflatten(1, sums.shape[1:3])

    def rows(self, part: slice) -> BandedFactor:
        """Return the factors of selected segments."""
        return BandedFactor(self.diagonal[part], self.below[part])


def _blocks(bands: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Return diagonal blocks (lower triangle used) and the blocks to their left, (B, N, R, R)."""
    count, size = bands[0].shape[1], bands[0].shape[-1]
    many = max(len(bands) - 1, -(-ROWS // size))  # number of sums per block, at least the bandwidth
    number = -(-count // many)
    # (B, N, row, column, D, D); the columns are those of the previous block and of this one
    store = bands[0].new_zeros(len(bands[0]), number, many, 2 * many, size, size)
    for distance, band in enumerate(bands):
        column = torch.arange(count - distance, device=store.device)
        block, row = (column + distance) // many, (column + distance) % many
        store[:, block, row, column - (block - 1) * many] = band
    beyond = torch.arange(count, number * many, device=store.device)
    store[:, beyond // many, beyond % many, beyond % many + many] = torch.eye(size).to(store)
    flat = store.transpose(3, 4).flatten(4, 5).flatten(2, 3)
    return flat[..., many * size :], flat[..., : many * size]
