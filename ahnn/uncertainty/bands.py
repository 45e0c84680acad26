"""Effect of parameter uncertainty on rollouts, to first order."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import own_jacobians
from ahnn.shooting.path_sensitivities import Steps, in_quarters, path, sensitivities
from ahnn.shooting.quadrature import coarse

CELLS = 4e7
"""Size limit of the largest sensitivity tensor; larger batches are divided into parts."""


@torch.no_grad()
def rollout_covariances(dynamics: Dynamics, start: Tensor, lengths: Tensor, factor: Tensor) -> Tensor:
    """Return the covariances (B, N + 1, D, D) of rollouts from exact starts.

    With x_k the state after k steps, C_k = (dx_k/dtheta) L L^T (dx_k/dtheta)^T. This is valid to first order:
    a band as wide as the motion itself only indicates that the state is unknown.

    Args:
        dynamics: float64 dynamics with a field and parameters theta.
        start: (B, D) initial states.
        lengths: step lengths, (B, N).
        factor: L, shape (P, R); L L^T is the covariance of theta.
    """
    parts = rollout_sensitivities(dynamics, start, lengths, factor)
    return torch.cat([(moved @ moved.mT).double() for moved in parts])


@torch.no_grad()
def rollout_sensitivities(
    dynamics: Dynamics, start: Tensor, lengths: Tensor, factor: Tensor
) -> Iterator[Tensor]:
    """Yield (dx_k/dtheta) L in float32, (b, N + 1, D, R), for batches of rollouts.

    Steps too long for the trapezoidal rule are quartered.

    Args:
        dynamics: float64 dynamics with a field and parameters theta.
        start: (B, D) initial states.
        lengths: step lengths, (B, N).
        factor: L, shape (P, R).
    """
    steps = Steps(lengths, torch.arange(lengths.shape[1] + 1))
    states = path(dynamics.increment, start, lengths)
    if coarse(cast(HasField, dynamics).field, states, lengths):
        steps, states = steps.quarters(), in_quarters(dynamics.increment, states, lengths)
    jacobians = own_jacobians(dynamics)(states[:, :-1], steps.lengths)
    return path_sensitivities(dynamics, states, jacobians, steps, factor)


@torch.no_grad()
def path_sensitivities(
    dynamics: Dynamics, states: Tensor, jacobians: Tensor, steps: Steps, factor: Tensor
) -> Iterator[Tensor]:
    """Yield (dx_k/dtheta) L at the selected times, (b, K + 1, D, R), for batches of paths.

    Args:
        dynamics: float64 dynamics with a field and parameters theta.
        states: states of the paths, (B, N + 1, D).
        jacobians: Jacobians of the steps, (B, N, D, D); they determine the precision of the result.
        steps: steps between the times.
        factor: L, shape (P, R).
    """
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing = field_jacobian(cast(HasField, dynamics), jacobians.dtype)
    rows = max(1, int(CELLS // (states.shape[1] * states.shape[2] * len(theta))))
    for k in range(0, max(1, len(states)), rows):
        part = slice(k, k + rows)
        driven = forcing(theta, states[part]) @ factor.to(jacobians)
        yield sensitivities(jacobians[part], driven, steps.rows(part))
