"""Standard deviations of a state as people give them: a number for each component, or one for each block."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.numbers import as_float64
from ahnn.types import Space

SECOND = {True: "velocities", False: "momenta"}
"""What the second half of a state is given as, by whether p = m dq/dt."""


def require_squares(deviations: Tensor, who: str) -> Tensor:
    """Return standard deviations > 0 whose squares float64 holds; raises UserError for others."""
    squares = deviations.square()
    held = squares.isfinite() & (squares >= torch.finfo(torch.float64).tiny)
    if not bool(held.all()):
        message = (
            f"{who}: expected standard deviations whose squares float64 holds, from 1e-150 to 1e+150; "
            f"received {deviations.tolist()}"
        )
        raise UserError(message)
    return deviations


def state_deviations(given: Any, space: Space, who: str) -> Tensor:
    """Return the standard deviations (2n,) of a state.

    Args:
        given: 2n numbers, one for each component, or two, for positions and for velocities; of one degree of
            freedom two numbers are of q and p.
        space: what the numbers of a state mean.
        who: the parameter, for messages.

    Raises:
        UserError: another count, or numbers that are not positive.
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
