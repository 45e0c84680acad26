"""Training domain of learned dynamics, and novelty of states.

Far from its training data, a network is unreliable without any indication. Representative training states are
therefore saved, spread evenly in the networks' input space; the novelty of a state is the distance to the
nearest one. The unit is the distance exceeded by one training state in a hundred, or slightly more for dense
data; states of novelty up to 1 are within the training domain. Exactly known terms, such as p^2 / 2m, have no
inputs and do not contribute.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.stored import Known, read

KEPT = 500
"""Maximum number of representative states; at most half of the training states. The rest define the unit."""
FARTHEST = 0.01
"""Fraction of the training states with novelty above 1."""

TOGETHER = 20_000
"""Number of states compared at once."""
FINEST = 0.04
"""Minimum unit, as a fraction of half the range of the inputs: a smooth network is still reliable slightly
outside dense data.
"""
BEYOND = 1.5
"""Novelty above which a state is flagged: unseen trajectories similar to the training data reach 1.3."""
RATE = 500.0
"""Growth rate of a learned force's error with the square of novelty - 1 (docs/novelty.md)."""


class Domain(NamedTuple):
    """Representative training states.

    Attributes:
        states: (K, D) states in the units of the space.
        unit: distance of inputs that corresponds to novelty 1.
    """

    states: Tensor
    unit: float

    def about(self) -> dict[str, Any]:
        """Return plain values for `domain_of`, rounded to nine digits, sufficient for distances."""
        return {
            "unit": self.unit,
            "states": [[float(f"{v:.9g}") for v in row] for row in self.states.tolist()],
        }

    @torch.no_grad()
    def novelty(self, dynamics: Dynamics, x: Tensor) -> Tensor:
        """Return the novelty of states, i.e. their scaled distance from training states, shape (...).

        Args:
            dynamics: dynamics that define the inputs.
            x: (..., D) float64; NaN gives NaN.
        """
        return _distances(dynamics.seen(x), dynamics.seen(self.states)) / self.unit


def growth(novelty: Tensor, rate: float = RATE) -> Tensor:
    """Return the factor >= 1 on the error of a learned force at states of given novelty.

    It grows slowly at first, since one training state in a hundred has a novelty slightly above 1.
    """
    return 1 + rate * (novelty - 1).clamp(min=0).square()


@torch.no_grad()
def find_domain(dynamics: Dynamics, states: Tensor) -> Domain:
    """Determine the domain of training states (M, D), float64, from the inputs of fitted dynamics.

    States are chosen one by one, each farthest from the previous ones (Gonzalez 1985), so that rarely sampled
    regions such as a perigee are represented.
    """
    inputs = dynamics.seen(states)
    chosen, nearest = [0], torch.full(inputs.shape[:1], torch.inf, dtype=inputs.dtype)
    for _ in range(min(KEPT, len(states) // 2) - 1):
        nearest = torch.minimum(nearest, (inputs - inputs[chosen[-1]]).norm(dim=-1))
        chosen.append(int(nearest.argmax()))
    nearest = torch.minimum(nearest, (inputs - inputs[chosen[-1]]).norm(dim=-1))
    half = float((inputs.amax(0) - inputs.amin(0)).max()) / 2
    unit = max(float(nearest.quantile(1 - FARTHEST)), FINEST * half)
    return Domain(states[chosen], unit if unit > 0 else 1.0)  # constant inputs


def domain_of(about: dict[str, Any], size: int) -> Domain | None:
    """Read the domain from the metadata of weights; None for weights of earlier versions.

    Args:
        about: metadata of the weights.
        size: number D of state components.

    Raises:
        UserError: damaged metadata.
    """
    if about.get("domain") is None:
        return None
    known = read("domain", Known, about["domain"])
    if not known.states or {len(row) for row in known.states} != {size}:
        message = (
            f"domain: expected training states of {size} components with the weights; received a different "
            "number"
        )
        raise UserError(message)
    return Domain(torch.tensor(known.states, dtype=torch.float64), known.unit)


def _distances(inputs: Tensor, known: Tensor) -> Tensor:
    """Return the distance (...) of inputs (..., F) from the nearest known ones (K, F)."""
    flat = inputs.reshape(-1, inputs.shape[-1])
    # Expanding |a - b|² as a product would lose the digits that distinguish nearby points.
    exact = "donot_use_mm_for_euclid_dist"
    parts = [torch.cdist(part, known, compute_mode=exact).amin(-1) for part in flat.split(TOGETHER)]
    return torch.cat(parts).reshape(inputs.shape[:-1])
