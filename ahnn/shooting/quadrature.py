"""Error of the trapezoidal rule along a path, which decides whether to quarter steps for Simpson's rule."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Field = Callable[[Tensor], Tensor]
"""States (..., D) -> their rates, (..., D)."""
COARSE = 3e-3
"""Error of the trapezoidal rule, relative to the field, above which steps are quartered.

The initial state can compensate all but 1e-5 of the effect of parameters on a path: quadrature errors of that
size look like information about parameters that no measurement determines, or like an unpredictable path.
"""


def coarse(field: Field, states: Tensor, lengths: Tensor) -> bool:
    """Return whether steps of lengths (B, N) along paths (B, N + 1, D) should be quartered.

    True if one path requires it, or if a path has a single step, whose error cannot be estimated.
    """
    return bool((rule_error(field, states, lengths) > COARSE).any())


@torch.no_grad()
def rule_error(field: Field, states: Tensor, lengths: Tensor) -> Tensor:
    """Estimate the relative error of the trapezoidal rule for forces along each path, shape (B,).

    It is h^2 / 12 times the second derivative of the forces, relative to the forces; non-finite steps are
    ignored, and a path without two consecutive steps has infinite error.

    Args:
        field: field whose forces, the last half of the rates, are used.
        states: (B, N + 1, D) states.
        lengths: step lengths, (B, N).
    """
    forces = field(states)[..., states.shape[-1] // 2 :]
    slopes = forces.diff(dim=1) / lengths.unsqueeze(-1)
    before, after = lengths[:, :-1], lengths[:, 1:]
    bends = before * after / (6 * (before + after)) * slopes.diff(dim=1).norm(dim=-1)
    bend, force = (x.where(x.isfinite(), torch.nan).nanmean(1) for x in (bends, forces.norm(dim=-1)))
    return (bend / force).where(bend.isfinite(), torch.inf)
