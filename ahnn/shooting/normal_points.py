"""Normal points: compression of neighbouring measurements to one time, as in laser ranging.

The effect of the initial state on a path is preserved exactly. The effect of parameters within a group is
neglected: for an effect that grows with t², a fraction (τ / t)², with the duration τ of a group. Residuals
are exact, so the optimum is unchanged.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.shooting.initial_states import Linearised
from ahnn.shooting.path_sensitivities import transitions

POINTS = 200
"""Minimum number of groups on a path with at least as many measurement times; the maximum is 2 POINTS - 1."""


def normal_points(now: Linearised, ends: Tensor) -> tuple[Linearised, Tensor]:
    """Return compressed residuals with the same normal equations, and the indices of their path states, (G,).

    Each group is reduced to one row per observed state component: 15 values at one time, three from each of
    five stations, become 3.

    Args:
        now: residuals at K + 1 times.
        ends: (K + 1,) indices of the path states at these times.
    """
    size = max(1, len(ends) // POINTS)
    of_state, middles = now.of_state, ends
    if size > 1:
        of_state, middles = _of_middles(now, ends, size)
    seen = of_state.flatten(0, -2).any(0)
    if seen.sum() >= of_state.shape[-2]:
        return now, ends
    basis, triangle = torch.linalg.qr(of_state[..., seen])
    of_points = of_state.new_zeros(*triangle.shape[:-1], len(seen))
    of_points[..., seen] = triangle
    residuals = (basis.mT @ _grouped(now.residuals.unsqueeze(-1), size)).squeeze(-1)
    return Linearised(now.jacobians, residuals, of_points, basis.mT @ _grouped(now.of_start, size)), middles


def _of_middles(now: Linearised, ends: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Return derivatives with respect to central states of groups, (B, G, size M, D), and their indices."""
    last = len(ends) - 1
    middles = torch.arange(size // 2, last + size // 2 + 1, size, device=ends.device)
    middles = ends[middles.clamp(max=last)]
    moved = transitions(now.jacobians.to(now.of_state), set(ends[::size].tolist()))
    back = torch.linalg.inv(moved[:, middles])
    return _grouped(now.of_state @ moved[:, ends], size) @ back, middles


def _grouped(values: Tensor, size: int) -> Tensor:
    """Return values (B, K + 1, M, D) grouped by times, (B, G, size M, D), the last padded with zeros."""
    missing = -values.shape[1] % size
    return pad(values, (0, 0, 0, 0, 0, missing)).unflatten(1, (-1, size)).flatten(2, 3)
