"""Range in which first-order covariances of predicted states are valid.

Paths displaced by one standard deviation in opposite directions are symmetric about the predicted path as
long as errors propagate linearly. Half the sum of both displacements, in standard deviations of each
component, is an index of nonlinearity (cf. Junkins & Singla 2004, J. Astronaut. Sci. 52, 7-60).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

LINEAR = 0.5
"""Index of nonlinearity up to which bands of chaotic motion are calibrated (docs/calibration.md)."""
SMALL = 1e-3
"""Fraction of a displacement at which the derivative of the flow is taken."""

IntervalFlow = Callable[[int, Tensor], Tensor]
"""(k, states (S, B, D) at time k) -> states at time k + 1, (S, B, D)."""


def largest_displacement(columns: Tensor) -> Tensor:
    """Return unit weights (B, R) of the causes that displace the last state most.

    The displacement is one standard deviation along the principal axis of the last state's covariance, with
    each component scaled by its standard deviation.

    Args:
        columns: factors C of the last state's covariances C C^T, (B, D, R); causes have unit variance.
    """
    columns = columns.nan_to_num(0, 0, 0)  # of paths that diverge
    deviations = columns.square().sum(-1, keepdim=True).sqrt()
    scaled = columns / deviations.where(deviations > 0, 1.0)
    _, axes = torch.linalg.eigh(scaled @ scaled.mT)
    weights = (scaled.mT @ axes[..., -1:]).squeeze(-1)
    return torch.nn.functional.normalize(weights, dim=-1)


@torch.no_grad()
def nonlinearity(flow: IntervalFlow, states: Tensor, moves: Tensor, deviations: Tensor) -> Tensor:
    """Return the index of nonlinearity of predicted states, (B, K + 1): the maximum over components.

    Effects of the parameters on a displaced path are taken from the linear displacement; the flow of the
    state is not linearised.

    Args:
        flow: flow between the times.
        states: predicted states, (B, K + 1, D).
        moves: their linear displacements by one standard deviation of a cause, (B, K + 1, D).
        deviations: their standard deviations, (B, K + 1, D).
    """
    signs = torch.tensor([1.0, -1.0]).to(states)[:, None, None]
    displaced = states[:, 0] + signs * moves[:, 0]
    bends = [torch.zeros_like(states[:, 0])]
    for k in range(states.shape[1] - 1):
        near = states[:, k] + SMALL * signs * moves[:, k]
        after = flow(k, torch.cat((displaced, near)))
        carried = (after[2] - after[3]) / (2 * SMALL)
        displaced = after[:2] + signs * (moves[:, k + 1] - carried)
        bends.append((displaced.sum(0) / 2 - states[:, k + 1]).abs())
    index = torch.stack(bends, dim=1) / deviations.where(deviations > 0, torch.inf)
    return index.nan_to_num(nan=torch.inf).amax(-1)
