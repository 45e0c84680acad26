"""User-supplied states and standard deviations, validated and expanded to one number per component."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.numbers import as_float64
from ahnn.types import Space

ROUNDING = 1e-10
"""Tolerance for asymmetry and negative eigenvalues of a covariance scaled to unit diagonal."""
SECOND = {True: "velocities", False: "momenta"}
"""Name of the second half of a state in user input, by whether p = m dq/dt."""


def require_squares(deviations: Tensor, who: str) -> Tensor:
    """Return standard deviations > 0 whose squares are representable in float64; else raise UserError."""
    squares = deviations.square()
    held = squares.isfinite() & (squares >= torch.finfo(torch.float64).tiny)
    if not bool(held.all()):
        message = (
            f"{who}: expected standard deviations whose squares are representable in float64, from "
            "1e-150 to 1e+150; "
            f"received {deviations.tolist()}"
        )
        raise UserError(message)
    return deviations


def state_deviations(given: Any, space: Space, who: str) -> Tensor:
    """Return the standard deviations (2n,) of a state.

    Args:
        given: 2n numbers, one for each component, or two, for positions and for velocities; for one degree of
            freedom, two numbers refer to q and p.
        space: description of the state components.
        who: parameter name for messages.

    Raises:
        UserError: a wrong count, or numbers that are not positive.
    """
    size = 2 * space.dof
    try:
        values = as_float64(given, who).flatten()
        if len(values) == 2 != size:
            values = values.repeat_interleave(space.dof)
            values[space.dof :] *= space.divisor
    except ValueError:
        values = torch.empty(0)
    if len(values) == size and bool(((values > 0.0) & values.isfinite()).all()):
        return require_squares(values, who)
    expected = f"{size} numbers > 0, or one for positions and one for {SECOND[space.mechanical]}"
    message = f"{who}: expected {expected}; received {given}"
    raise UserError(message)


def require_finite(states: Tensor) -> None:
    """Raise UserError for starts (B, D) with NaN, infinity, or numbers whose squares overflow."""
    wrong = ~states.square().isfinite().all(-1)
    if bool(wrong.any()):
        row = int(wrong.nonzero()[0])
        message = (
            f"start: expected finite numbers up to 1e150; received {states[row].tolist()} in start {row + 1}"
        )
        raise UserError(message)


def covariance_factor(given: Any, size: int, who: str) -> Tensor:
    """Return factors F, covariance = F F^T, of covariances (D, D) or (B, D, D) of a state.

    Raises:
        UserError: a wrong shape, non-finite numbers, or a matrix that is not a covariance.
    """
    try:
        matrix = as_float64(given, who)
    except ValueError as error:
        raise UserError(str(error)) from error
    fits = matrix.ndim in (2, 3) and matrix.shape[-2:] == (size, size) and bool(matrix.isfinite().all())
    if fits:
        sd = matrix.diagonal(dim1=-2, dim2=-1).clamp(min=0.0).sqrt()
        unit = torch.where(sd > 0.0, 1.0 / sd, 1.0)
        scaled = unit.unsqueeze(-1) * matrix * unit.unsqueeze(-2)
        values, vectors = torch.linalg.eigh(scaled)
        if torch.allclose(scaled, scaled.mT, rtol=0.0, atol=ROUNDING) and bool((values > -ROUNDING).all()):
            return sd.unsqueeze(-1) * vectors * values.clamp(min=0.0).sqrt().unsqueeze(-2)
    message = f"{who}: expected a {size} x {size} covariance without negative eigenvalues; received {given}"
    raise UserError(message)
