"""Range in which first-order covariances of predicted states are valid.

Paths displaced by one standard deviation in opposite directions are symmetric about the predicted path as
long as errors propagate linearly. Half the sum of both displacements, their asymmetry, is an index of
nonlinearity (cf. Junkins & Singla 2004, J. Astronaut. Sci. 52, 7-60): in standard deviations of each
component for the bands of single components, and in the norm of the covariance for joint statements such as
the NEES. On an orbit whose position along the track is poorly known the joint index is the larger one by
orders of magnitude, since errors follow the curved track out of a flat covariance.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

LINEAR = 0.5
"""Index of nonlinearity up to which bands of chaotic motion are calibrated (docs/calibration.md)."""
THIN = 1e-3
"""Smallest standard deviation along any direction, relative to those of the components, that is resolved."""
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
def asymmetry(flow: IntervalFlow, states: Tensor, moves: Tensor) -> Tensor:
    """Return half the sum of opposite displacements of predicted states, (B, K + 1, D).

    Effects of the parameters on a displaced path are taken from the linear displacement; the flow of the
    state is not linearised.

    Args:
        flow: flow between the times.
        states: predicted states, (B, K + 1, D).
        moves: their linear displacements by one standard deviation of a cause, (B, K + 1, D).
    """
    signs = torch.tensor([1.0, -1.0]).to(states)[:, None, None]
    displaced = states[:, 0] + signs * moves[:, 0]
    bends = [torch.zeros_like(states[:, 0])]
    for k in range(states.shape[1] - 1):
        near = states[:, k] + SMALL * signs * moves[:, k]
        after = flow(k, torch.cat((displaced, near)))
        carried = (after[2] - after[3]) / (2 * SMALL)
        displaced = after[:2] + signs * (moves[:, k + 1] - carried)
        bends.append(displaced.sum(0) / 2 - states[:, k + 1])
    return torch.stack(bends, dim=1)


def nonlinearity(bends: Tensor, deviations: Tensor) -> Tensor:
    """Return the index of nonlinearity of single components: the maximum over them, (B, K + 1).

    Args:
        bends: asymmetry of the displaced paths, (B, K + 1, D).
        deviations: standard deviations of the states, (B, K + 1, D).
    """
    index = bends.abs() / deviations.where(deviations > 0, torch.inf)
    return index.nan_to_num(nan=torch.inf).amax(-1)


def joint_nonlinearity(bends: Tensor, columns: Tensor) -> Tensor:
    """Return the index of nonlinearity of the joint covariance, (B, K + 1): the norm of the asymmetry in it.

    Directions thinner than `THIN` standard deviations of the components count as that thick. An index m
    raises the mean NEES by about 3 m^2.

    Args:
        bends: asymmetry of the displaced paths, (B, K + 1, D).
        columns: factors C of the covariances C C^T, (B, K + 1, D, R).
    """
    columns = columns.nan_to_num(0, 0, 0)  # of paths that diverge
    deviations = columns.square().sum(-1).sqrt()
    scales = deviations.where(deviations > 0, 1.0)
    variances, axes = torch.linalg.eigh((scaled := columns / scales.unsqueeze(-1)) @ scaled.mT)
    along = (axes.mT @ (bends / scales).nan_to_num(torch.inf, torch.inf, torch.inf).unsqueeze(-1)).squeeze(-1)
    index = (along.square() / variances.clamp(min=THIN**2)).sum(-1).sqrt()
    return index.nan_to_num(nan=torch.inf)
