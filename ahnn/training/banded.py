"""Covariances of sums that overlap with their neighbours alone: banded, so that whitening is cheap."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

LEAST = 16
"""Rows of a block, at least."""


class Factor(NamedTuple):
    """The Cholesky factor L of banded matrices (..., J, J), in blocks that touch their neighbours alone.

    Attributes:
        diagonal: the blocks L_kk, (..., K, K).
        below: the blocks L_k,k-1 that stand left of these; none of the first.
    """

    diagonal: list[Tensor]
    below: list[Tensor]

    @classmethod
    def of(cls, matrix: Tensor, band: int) -> Factor:
        """Return the factor of positive definite matrices (..., J, J), zero beyond `band` diagonals."""
        size = max(band, LEAST)
        parts = [slice(k, k + size) for k in range(0, matrix.shape[-1], size)]
        diagonal = [torch.linalg.cholesky(matrix[..., parts[0], parts[0]])]
        below: list[Tensor] = []
        for before, own in pairwise(parts):
            left = torch.linalg.solve_triangular(diagonal[-1], matrix[..., before, own], upper=False).mT
            below.append(left)
            diagonal.append(torch.linalg.cholesky(matrix[..., own, own] - left @ left.mT))
        return cls(diagonal, below)

    def whiten(self, sums: Tensor) -> Tensor:
        """Return L^-1 s of sums (..., J, M) whose covariance is L L^T, in their precision."""
        done: list[Tensor] = []
        sizes = [block.shape[-1] for block in self.diagonal]
        for k, own in enumerate(sums.split(sizes, dim=-2)):
            rest = own - self.below[k - 1].to(own) @ done[-1] if k else own
            done.append(torch.linalg.solve_triangular(self.diagonal[k].to(own), rest, upper=False))
        return torch.cat(done, dim=-2)

    def rows(self, part: slice, last: int) -> Factor:
        """Return the last so many (dimension 1) of some of the matrices (0); one for all alike stays."""
        part = slice(None) if len(self.diagonal[0]) == 1 else part
        return Factor(*([block[part, -last:] for block in blocks] for blocks in self))
