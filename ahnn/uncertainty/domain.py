"""Where dynamics were learned, and how far from there a state is.

A network says nothing of states that its training never showed it, and does not know. So some of the training
states are kept, spread evenly over what the networks see of them, and a state is as novel as its nearest one
is far away. The unit is the distance that one training state in a hundred exceeds, or a little more where
data are dense: up to 1 is known ground. What is known exactly, such as p^2 / 2m, has no inputs and makes no
state novel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.stored import Known, read

KEPT = 500
"""Training states that are kept, at most half of them: the others say how far apart neighbours are."""
FARTHEST = 0.01
"""Fraction of the training states that are farther than 1 from all of them."""

TOGETHER = 20_000
"""States that are compared at once."""
FINEST = 0.04
"""Least unit, as a fraction of half the range of the inputs: where data are dense, a smooth network still
knows what lies a little beside them."""
BEYOND = 1.5
"""Novelty from which a state is flagged: unseen trajectories of the training's kind reach 1.3."""
RATE = 500.0
"""Times the square of novelty - 1: what the error of a learned force grows by (docs/novelty.md)."""


class Domain(NamedTuple):
    """Training states that stand for all.

    Attributes:
        states: (K, D), in the units of the space.
        unit: distance of the inputs that counts as 1.
    """

    states: Tensor
    unit: float

    def about(self) -> dict[str, Any]:
        """Return plain values, as `domain_of` reads them; nine digits are more than a distance needs."""
        return {
            "unit": self.unit,
            "states": [[float(f"{v:.9g}") for v in row] for row in self.states.tolist()],
        }

    @torch.no_grad()
    def novelty(self, dynamics: Dynamics, x: Tensor) -> Tensor:
        """Return how far states are from those of the training, shape (...).

        Args:
            dynamics: whose inputs count.
            x: (..., D) float64; NaN has NaN.
        """
        return _distances(dynamics.seen(x), dynamics.seen(self.states)) / self.unit


def growth(novelty: Tensor, rate: float = RATE) -> Tensor:
    """Return the factor, at least 1, on the error of a learned force at states of some novelty.

    It begins gently: one training state in a hundred lies a little beyond 1.
    """
    return 1 + rate * (novelty - 1).clamp(min=0).square()


@torch.no_grad()
def find_domain(dynamics: Dynamics, states: Tensor) -> Domain:
    """Return the domain of some training states (M, D), float64, by the inputs of fitted dynamics.

    Each state that is kept is the one farthest from those kept so far (Gonzalez 1985), so that rare places
    such as a perigee have their share.
    """
    inputs = dynamics.seen(states)
    chosen, nearest = [0], torch.full(inputs.shape[:1], torch.inf, dtype=inputs.dtype)
    for _ in range(min(KEPT, len(states) // 2) - 1):
        nearest = torch.minimum(nearest, (inputs - inputs[chosen[-1]]).norm(dim=-1))
        chosen.append(int(nearest.argmax()))
    nearest = torch.minimum(nearest, (inputs - inputs[chosen[-1]]).norm(dim=-1))
    half = float((inputs.amax(0) - inputs.amin(0)).max()) / 2
    unit = max(float(nearest.quantile(1 - FARTHEST)), FINEST * half)
    return Domain(states[chosen], unit if unit > 0 else 1.0)  # they do not vary


def domain_of(about: dict[str, Any], size: int) -> Domain | None:
    """Return the domain beside weights; None where an earlier version wrote none.

    Args:
        about: what stands beside the weights.
        size: D, number of state components.

    Raises:
        UserError: it is damaged.
    """
    if about.get("domain") is None:
        return None
    known = read("domain", Known, about["domain"])
    if not known.states or {len(row) for row in known.states} != {size}:
        message = f"domain: expected training states of {size} components beside the weights; received others"
        raise UserError(message)
    return Domain(torch.tensor(known.states, dtype=torch.float64), known.unit)


def _distances(inputs: Tensor, known: Tensor) -> Tensor:
    """Return the distance (...) of each of the inputs (..., F) from the nearest of the known ones (K, F)."""
    flat = inputs.reshape(-1, inputs.shape[-1])
    # |a - b|² as a product would lose the digits that near points differ by.
    exact = "donot_use_mm_for_euclid_dist"
    parts = [torch.cdist(part, known, compute_mode=exact).amin(-1) for part in flat.split(TOGETHER)]
    return torch.cat(parts).reshape(inputs.shape[:-1])
