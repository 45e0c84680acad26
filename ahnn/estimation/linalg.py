"""Factors of covariance matrices, batched: triangularisation, downdate, repair."""

from __future__ import annotations

import torch
from torch import Tensor

EPS = torch.finfo(torch.float64).eps


def tria(rows: Tensor) -> Tensor:
    """Return the lower L, shape (B, D, D) and diagonal >= 0, with L Lᵀ = rowsᵀ rows.

    Uses Householder QR, which avoids the Gram matrix with its squared condition number. Differentiable where
    L has full rank.

    Args:
        rows: (B, N, D) with N >= D.
    """
    # The derivative needs the orthogonal factor; otherwise the triangular factor suffices.
    mode = "reduced" if torch.is_grad_enabled() and rows.requires_grad else "r"
    upper = torch.linalg.qr(rows, mode=mode).R
    diagonal = torch.diagonal(upper, dim1=-2, dim2=-1)
    # copysign instead of sign: a zero on the diagonal must not erase its row.
    return (upper * torch.copysign(torch.ones_like(diagonal), diagonal).unsqueeze(-1)).mT


def downdate(chol: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lower factor of L Lᵀ - v vᵀ, and a mask of members that have one.

    With p = L⁻¹ v, L Lᵀ - v vᵀ = L (I - g p pᵀ)² Lᵀ where g = (1 - sqrt(1 - |p|²)) / |p|². A member with
    |p| >= 1 has no factor and keeps its L.

    Args:
        chol: (B, D, D) lower factors.
        vector: (B, D).

    Returns:
        Factors (B, D, D) and a (B,) bool that is true where the downdate was possible.
    """
    p = torch.linalg.solve_triangular(chol, vector.unsqueeze(-1), upper=False).squeeze(-1)
    norm2 = (p * p).sum(-1)
    possible = norm2 < 1.0
    root = (1.0 - torch.where(possible, norm2, 0.0)).sqrt()
    p = torch.where(possible.unsqueeze(-1), p, 0.0)
    # (1 - root) / |p|² without cancellation.
    factor = (1.0 / (1.0 + root))[:, None, None]
    image = (chol * p.unsqueeze(-2)).sum(-1, keepdim=True)
    lowered = tria((chol - factor * image * p.unsqueeze(-2)).mT)
    return torch.where(possible[:, None, None], lowered, chol), possible


def cholesky_repaired(covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Return lower Cholesky factors, repaired where the covariance is not positive definite.

    The repair raises the eigenvalues of the correlation matrix to at least D eps. Only members that need it
    are changed, and they are reported.

    Args:
        covariance: (B, D, D), symmetric.

    Returns:
        Factors (B, D, D) and a (B,) bool that is true where the factor was repaired. Matrices that are not
        finite give NaN, those with a negative or zero variance give zeros; neither is reported as repaired.
    """
    chol, info = torch.linalg.cholesky_ex(covariance)
    failed = info != 0
    if not bool(failed.any()):
        return chol, failed
    variance = torch.diagonal(covariance, dim1=-2, dim2=-1)
    finite = torch.isfinite(covariance).all(-1).all(-1)
    mendable = failed & finite & (variance > 0.0).all(-1)
    chol = torch.where((failed & finite & ~mendable)[:, None, None], 0.0, chol)
    chol = torch.where(finite[:, None, None], chol, torch.nan)
    for b in torch.nonzero(mendable).flatten().tolist():
        chol[b] = _mended(covariance[b])
    return chol, mendable


def _mended(covariance: Tensor) -> Tensor:
    """Return a lower factor (D, D) near an indefinite covariance (D, D) with positive diagonal."""
    deviation = torch.diagonal(covariance).sqrt()
    values, vectors = torch.linalg.eigh(covariance / torch.outer(deviation, deviation))
    rows = (vectors * values.clamp(min=len(deviation) * EPS).sqrt()).mT * deviation
    return tria(rows.unsqueeze(0)).squeeze(0)
