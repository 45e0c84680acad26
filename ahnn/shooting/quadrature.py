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


def coarse(field: Field, states: Tensor) -> bool:
    """Return whether steps between states (B, N + 1, D) are to be quartered before parameters move them."""
    return rule_error(field, states) > COARSE


@torch.no_grad()
def rule_error(field: Field, states: Tensor) -> float:
    """Return about what share of the forces the trapezoidal rule is off by along paths (B, N + 1, D)."""
    sound = states[states.isfinite().flatten(1).all(1)]
    forces = field(sound)[..., states.shape[-1] // 2 :]
    bend = forces.diff(n=2, dim=1).norm(dim=-1) / 12
    return float(bend.mean() / forces.norm(dim=-1).mean()) if bend.numel() else 0.0
