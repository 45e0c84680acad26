"""Validation and factorisation of user-supplied covariance matrices."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.linalg import tria
from ahnn.numbers import Numbers, as_float64

TOLERANCE = 1e-10
"""Tolerance for rounding: asymmetry and negative eigenvalues of a matrix scaled to unit diagonal."""


class Factor(NamedTuple):
    """Covariance given by its lower factor instead of a matrix, without further checks.

    Attributes:
        chol: (D, D) or (B, D, D) float64, covariance = chol cholᵀ.
    """

    chol: Tensor


Covariance = Numbers | Factor
"""Covariance matrix from a user, or a factor of a checked covariance."""


def initial_belief(mean: Numbers, covariance: Numbers) -> Belief:
    """Build the initial Gaussian belief of a filter.

    Args:
        mean: (B, D) states, B >= 1.
        covariance: (D, D) shared, or (B, D, D); symmetric and positive definite.

    Raises:
        ValueError: a mean that is complex or not finite, or a covariance that is not a positive definite (D,
            D) matrix.
    """
    mean = as_float64(mean, "initial_belief: mean")
    if mean.ndim != 2 or 0 in mean.shape:
        shape = tuple(mean.shape)
        message = f"initial_belief: expected a mean of shape (B, D) with B >= 1; received {shape}"
        raise ValueError(message + ("; use mean[None]" if mean.ndim == 1 else ""))
    finite = torch.isfinite(mean).all(-1)
    if not bool(finite.all()):
        message = (
            f"initial_belief: the mean of member {int((~finite).nonzero()[0])} is not finite; drop the member"
        )
        raise ValueError(message)
    batch, size = mean.shape
    chol = covariance_factor(covariance, "P0", batch=batch, size=size, definite=True)
    return Belief(mean, chol.to(mean.device).expand(batch, size, size))


def covariance_factor(matrix: Covariance, name: str, *, batch: int, size: int, definite: bool) -> Tensor:
    """Return the lower factor, (D, D) or (B, D, D), of a user-supplied covariance matrix.

    Differentiable if the components of nonzero variance have a positive definite covariance.

    Args:
        matrix: (D, D) or (B, D, D), or its factor, which is returned unchanged.
        name: name of the matrix in messages.
        batch: number of members B.
        size: dimension D.
        definite: whether to reject a singular matrix.

    Raises:
        ValueError: not numeric, wrong shape, not finite, not symmetric, indefinite, or singular if
            `definite`.
    """
    factored = isinstance(matrix, Factor)
    matrix = matrix.chol if isinstance(matrix, Factor) else as_float64(matrix, name)
    shape = tuple(matrix.shape)
    if shape not in {(size, size), (batch, size, size)}:
        message = f"{name}: expected shape ({size}, {size}) or ({batch}, {size}, {size}); received {shape}"
        raise ValueError(message)
    if factored:
        return matrix
    stacked = matrix.reshape(-1, size, size)
    if torch.equal(stacked, stacked.mT):  # and therefore without NaN
        chol, info = torch.linalg.cholesky_ex(stacked)
        if not bool(info.any()) and math.isfinite(float(chol.detach().sum())):
            return chol.reshape(shape)
    return _checked_factor(stacked, name, definite).reshape(shape)


def _checked_factor(stacked: Tensor, name: str, definite: bool) -> Tensor:
    """Return factors of matrices (B, D, D), possibly singular; errors as in `covariance_factor`."""
    scale = _check_entries(stacked.detach(), name)
    # A component of zero variance has a zero row in the factor; gradients of the other components bypass it.
    still = torch.diagonal(stacked.detach(), dim1=-2, dim2=-1) == 0.0
    chol, info = torch.linalg.cholesky_ex(stacked + torch.diag_embed(still.to(stacked)))
    chol = chol * ~still.unsqueeze(-1)
    failed = (info != 0) | (definite & still.any(-1))
    if bool(failed.any()):
        _check_eigenvalues(stacked.detach(), scale, failed, name, definite)
        chol = torch.where(failed[:, None, None], _semidefinite_factor(stacked, scale), chol)
    return chol


def _check_entries(matrix: Tensor, name: str) -> Tensor:
    """Check that matrices are finite and symmetric; return their standard deviations (B, D) as scales.

    An uncorrelated component of zero variance has scale 1.
    """
    if not bool(torch.isfinite(matrix).all()):
        message = f"{name}: expected finite entries; received {matrix.tolist()}"
        raise ValueError(message)
    variance = torch.diagonal(matrix, dim1=-2, dim2=-1)
    if bool((variance < 0.0).any()):
        b, i = (int(n) for n in torch.nonzero(variance < 0.0)[0])
        where = f" of member {b}" if len(matrix) > 1 else ""
        message = (
            f"{name}: expected no negative variance; received [{i}, {i}] = {float(variance[b, i]):.6g}{where}"
        )
        raise ValueError(message)
    deviation = variance.sqrt()
    product = deviation.unsqueeze(-1) * deviation.unsqueeze(-2)
    asymmetry = (matrix - matrix.mT).abs() - TOLERANCE * product
    if bool((asymmetry > 0.0).any()):
        b, i, j = (int(n) for n in torch.nonzero(asymmetry == asymmetry.max())[0])
        message = (
            f"{name}: expected a symmetric matrix; received [{i}, {j}] = {float(matrix[b, i, j])} but [{j}, "
            f"{i}] = {float(matrix[b, j, i])}; pass (A + A.mT) / 2 to symmetrise it"
        )
        raise ValueError(message)
    impossible = (variance == 0.0).unsqueeze(-1) & (matrix != 0.0)
    if bool(impossible.any()):
        b, i, j = (int(n) for n in torch.nonzero(impossible)[0])
        message = (
            f"{name}: expected zeros in the row of the zero variance [{i}, {i}]; received "
            f"[{i}, {j}] = {float(matrix[b, i, j]):.6g}; it is indefinite"
        )
        raise ValueError(message)
    return torch.where(variance > 0.0, deviation, 1.0)


def _check_eigenvalues(matrix: Tensor, scale: Tensor, failed: Tensor, name: str, definite: bool) -> None:
    """Raise ValueError for the first failed matrix (B, D, D): indefinite, or singular if `definite`."""
    correlation = matrix / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    for b in torch.nonzero(failed).flatten().tolist():
        smallest = float(torch.linalg.eigvalsh(matrix[b])[0])
        where = f" of member {b}" if len(matrix) > 1 else ""
        if float(torch.linalg.eigvalsh(correlation[b])[0]) < -TOLERANCE:
            message = (
                f"{name}: expected no negative eigenvalue; received {smallest:.6g}{where}; it is indefinite"
            )
            raise ValueError(message)
        if definite:
            message = (
                f"{name}: expected a positive definite matrix; received eigenvalue {smallest:.6g}{where}; "
                f"add a small variance to its diagonal"
            )
            raise ValueError(message)


def _semidefinite_factor(matrix: Tensor, scale: Tensor) -> Tensor:
    """Return lower factors of positive semidefinite matrices (B, D, D), including singular ones."""
    values, vectors = torch.linalg.eigh(matrix / (scale.unsqueeze(-1) * scale.unsqueeze(-2)))
    rows = (vectors * values.clamp(min=0.0).sqrt().unsqueeze(-2)).mT * scale.unsqueeze(-2)
    return tria(rows)
