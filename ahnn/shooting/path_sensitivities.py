"""Paths of a flow and their sensitivities to initial state and parameters.

Pure functions of increments (x, dt) -> x(t + dt) - x(t). A path is computed recursively, but its derivatives
are not: the Jacobians of all steps are formed in one batch and then multiplied.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.substeps import substeps_of_each

Increment = Callable[[Tensor, Tensor], Tensor]
"""(x (B, D), dt (B,)) -> x(t + dt) - x(t), shape (B, D)."""


class Steps(NamedTuple):
    """Integrator steps between the times of measurements.

    Attributes:
        lengths: (B, N) step lengths.
        ends: (K + 1,) index of the path state, from 0 to N, for each time.
        quartered: whether steps are quarters of longer ones, so that integrals use Simpson's rule.
    """

    lengths: Tensor
    ends: Tensor
    quartered: bool = False

    @property
    def weights(self) -> list[tuple[float, float]]:
        """Quadrature weights at the beginning and end of each step, as fractions of its length; N pairs."""
        rule = [(1 / 3, 2 / 3), (2 / 3, 1 / 3)] if self.quartered else [(0.5, 0.5)]
        return rule * (self.lengths.shape[1] // len(rule))

    def rows(self, part: slice | Tensor) -> Steps:
        """Return the steps of selected segments."""
        return self._replace(lengths=self.lengths[part])

    def halved(self) -> Steps:
        """Divide each step into two."""
        return self._replace(lengths=self.lengths.repeat_interleave(2, dim=1) / 2, ends=2 * self.ends)

    def quarters(self) -> Steps:
        """Divide each step into four, with integrals by Simpson's rule."""
        return Steps(self.lengths.repeat_interleave(4, dim=1) / 4, 4 * self.ends, quartered=True)

    def first(self, intervals: int) -> Steps:
        """Return the steps of the first intervals."""
        ends = self.ends[: intervals + 1]
        return self._replace(lengths=self.lengths[:, : int(ends[-1])], ends=ends)


def steps_between(times: Tensor, longest: float) -> Steps:
    """Build steps that end at all times (B, K + 1), none longer than `longest`.

    An interval has the same number of steps in every row: as many as its longest row needs.
    """
    gaps = times.diff(dim=1)
    counts = substeps_of_each(gaps.amax(0), longest)
    ends = torch.cat((counts.new_zeros(1), counts.cumsum(0)))
    return Steps((gaps / counts).repeat_interleave(counts, dim=1), ends)


def path(increment: Increment, start: Tensor, lengths: Tensor) -> Tensor:
    """Propagate initial states (B, D) over steps of lengths (B, N); return (B, N + 1, D)."""
    states = [start]
    for dt in lengths.unbind(1):
        states.append(states[-1] + increment(states[-1], dt))
    return torch.stack(states, dim=1)


def in_quarters(increment: Increment, states: Tensor, lengths: Tensor) -> Tensor:
    """Return the states (B, 4 N + 1, D) at the quarters of steps (B, N) along a path (B, N + 1, D).

    Each step starts from the state of the given path.
    """
    dt, x = (lengths / 4).flatten(), states[:, :-1].flatten(0, 1)
    quarters = [x]
    for _ in range(3):
        quarters.append(quarters[-1] + increment(quarters[-1], dt))
    inner = torch.stack(quarters, dim=1).view(len(states), -1, states.shape[-1])
    return torch.cat((inner, states[:, -1:]), dim=1)


def transitions(jacobians: Tensor, anew: Collection[int] = ()) -> Tensor:
    """Return dx_k/dx_0 of each state of a path, shape (B, N + 1, D, D), from the Jacobians of its steps.

    With indices `anew`: dx_k/dx_j, where j is the last of them up to k.
    """
    one = torch.eye(jacobians.shape[-1]).to(jacobians).expand_as(jacobians[:, 0])
    products = [one]
    for k, step in enumerate(jacobians.unbind(1), start=1):
        products.append(one if k in anew else step @ products[-1])
    return torch.stack(products, dim=1)


def sensitivities(jacobians: Tensor, forcing: Tensor, steps: Steps, first: Tensor | None = None) -> Tensor:
    """Return dx_k/dtheta at the measurement times, shape (B, K + 1, D, P).

    Solves the variational equation dS/dt = f_x S + f_theta with exact transitions and the trapezoidal or
    Simpson's rule: the relative error O(dt^2) or O(dt^4) affects step directions only, not the residuals.

    Args:
        jacobians: Jacobians of the steps, (B, N, D, D).
        forcing: f_theta, (B, N + 1, L, P): derivative of the last L components of the field with respect to
            the parameters; that of the others is zero.
        steps: step lengths, and indices of the requested states.
        first: dx_0/dtheta, (B, D, P); None for a fixed initial state.
    """
    rows, size = jacobians.shape[0], jacobians.shape[-1]
    driven = slice(size - forcing.shape[2], None)
    current = forcing.new_zeros(rows, size, forcing.shape[-1]) if first is None else first
    measured = set(steps.ends.tolist())
    wanted = [current] if 0 in measured else []
    for k, (before, after) in enumerate(steps.weights):
        dt = steps.lengths[:, k, None, None].to(forcing)
        kicked = current.clone()
        kicked[:, driven].addcmul_(before * dt, forcing[:, k])
        current = jacobians[:, k] @ kicked
        current[:, driven].addcmul_(after * dt, forcing[:, k + 1])
        if k + 1 in measured:
            wanted.append(current)
    return torch.stack(wanted, dim=1)


def adjoints(jacobians: Tensor, pulls: Tensor, steps: Steps) -> Tensor:
    """Return c, shape (B, N + 1, D), with sum c_k f_theta(x_k) = sum pulls_k dx_k/dtheta.

    Transpose of `sensitivities` for a fixed initial state: backwards through the same steps.

    Args:
        jacobians: Jacobians of the steps, (B, N, D, D).
        pulls: cotangents of the states at the measurement times, (B, K + 1, D).
        steps: step lengths, and indices of these states.
    """
    found = pulls.new_zeros(len(pulls), steps.lengths.shape[1] + 1, pulls.shape[-1])
    at = dict(zip(steps.ends.tolist(), pulls.unbind(1), strict=True))
    last = steps.lengths.shape[1]
    pull = at[last]
    for k, (before, after) in reversed([*enumerate(steps.weights)]):
        dt = steps.lengths[:, k, None]
        found[:, k + 1] += after * dt * pull
        pull = (pull.unsqueeze(1) @ jacobians[:, k]).squeeze(1)
        found[:, k] += before * dt * pull
        pull = pull + at.get(k, 0.0)
    return found
