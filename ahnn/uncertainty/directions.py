"""The few directions of learned parameters that move paths, of all in which they are uncertain."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.uncertainty.bands import rollout_sensitivities

SAMPLES = 50
"""Samples of a path at which directions are weighed, about."""


@torch.no_grad()
def leading_directions(
    dynamics: Dynamics, spread: Tensor, start: Tensor, lengths: Tensor, count: int
) -> Tensor:
    """Return directions S of the parameters, (P, K), with S S^T as near to L L^T as paths can tell.

    What a direction does to positions, and to momenta, counts as a fraction of what all of them do there, at
    all times alike: early in a path, where a filter looks, it moves little.

    Args:
        dynamics: with a field, float64.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        start: (B, D) that the paths begin at.
        lengths: of the steps, (B, N).
        count: K, at most; there are no more than R.
    """
    dof, apart = start.shape[1] // 2, max(1, lengths.shape[1] // SAMPLES)
    rows = []
    for moved in rollout_sensitivities(dynamics, start, lengths, spread):
        for part in moved[:, apart::apart].split(dof, dim=2):
            size = part.square().sum((2, 3), keepdim=True).sqrt()
            rows.append((part / size).nan_to_num(0.0, 0.0, 0.0).flatten(0, 2))
    axes = torch.linalg.svd(torch.cat(rows), full_matrices=False).Vh
    return spread @ axes[:count].mT.to(spread)


def field_columns(dynamics: Dynamics, directions: Tensor) -> Callable[[Tensor], Tensor]:
    """Return x (..., D) -> how the field moves along directions (P, K) of the parameters, (..., D, K)."""
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing, along = field_jacobian(cast(HasField, dynamics)), directions.float()

    @torch.no_grad()
    def columns(x: Tensor) -> Tensor:
        learned = (forcing(theta, x) @ along).to(x)
        known = learned.new_zeros(*x.shape[:-1], x.shape[-1] - learned.shape[-2], learned.shape[-1])
        return torch.cat((known, learned), dim=-2)

    return columns
