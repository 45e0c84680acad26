"""What the trapezoidal rule is off by along a path, and whether steps are to be quartered for Simpson's."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Field = Callable[[Tensor], Tensor]
"""States (..., D) -> their rates, (..., D)."""
COARSE = 3e-3
"""Error of the trapezoidal rule, as a share of the field, beyond which steps are quartered.

A start undoes up to all but 1e-5 of what parameters do to a path: what a rule leaves of that looks like
information about parameters that no measurement determines, or like a path that cannot be foretold.
"""


def coarse(field: Field, states: Tensor, lengths: Tensor) -> bool:
    """Return whether steps of lengths (B, N) along paths (B, N + 1, D) are to be quartered.

    They are where one path asks for it, and where a path has one step alone, which says nothing of itself.
    """
    return bool((rule_error(field, states, lengths) > COARSE).any())


@torch.no_grad()
def rule_error(field: Field, states: Tensor, lengths: Tensor) -> Tensor:
    """Return about what share of the forces the trapezoidal rule is off by along each path, shape (B,).

    It is h^2 / 12 times their second derivative; of steps that are not finite nothing counts, and infinity
    is that of a path without two steps in a row.

    Args:
        field: whose forces count, the last half of the rates.
        states: (B, N + 1, D).
        lengths: of the steps, (B, N).
    """
    forces = field(states)[..., states.shape[-1] // 2 :]
    slopes = forces.diff(dim=1) / lengths.unsqueeze(-1)
    before, after = lengths[:, :-1], lengths[:, 1:]
    bends = before * after / (6 * (before + after)) * slopes.diff(dim=1).norm(dim=-1)
    bend, force = (x.where(x.isfinite(), torch.nan).nanmean(1) for x in (bends, forces.norm(dim=-1)))
    return (bend / force).where(bend.isfinite(), torch.inf)
