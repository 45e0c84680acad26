"""Jacobians of functions that map each member of a batch by itself, by vectorised reverse mode."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.func import vjp, vmap

from ahnn.cores import each, slices

TOGETHER = 12_000
"""Numbers in states whose Jacobians are formed at once: what they take stays in the cache."""


def pointwise_jacobian(function: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Return df/dx, shape (..., M, D), of a function that maps each x (..., D) to its own f (..., M)."""
    # Nothing, but of x: where f does not depend on it, the process would crash (torch 2.13).
    along = lambda z: function(z) + 0.0 * z.sum(-1, keepdim=True)  # noqa: E731
    value, back = vjp(along, x)  # pyright: ignore[reportAssignmentType] - three with has_aux alone
    unit = torch.eye(value.shape[-1]).to(value)
    return vmap(lambda row: back(row.expand_as(value))[0], out_dims=-2)(unit)


def step_jacobians(increment: Callable[[Tensor, Tensor], Tensor], states: Tensor, lengths: Tensor) -> Tensor:
    """Return dx(t + dt)/dx(t) of each step, shape (B, N, D, D), of any flow.

    Args:
        increment: (x (B, D), dt (B,)) -> x(t + dt) - x(t), shape (B, D).
        states: (B, N, D) where steps begin.
        lengths: (B, N).
    """
    x, dt = states.flatten(0, 1), lengths.flatten()

    def rows(part: slice) -> Tensor:
        return pointwise_jacobian(lambda z: z + increment(z, dt[part]), x[part])

    return torch.cat(each(rows, slices(len(x), TOGETHER // x.shape[1]), x.device)).unflatten(0, lengths.shape)


def moved(step: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """Return states (B, D) after a step of states with variations, and its Jacobians (B, D, D)."""
    beside = torch.eye(x.shape[1]).to(x).expand(len(x), -1, -1)
    after = step(torch.cat((x.unsqueeze(1), beside), dim=1))
    return after[:, 0], after[:, 1:].mT


def differenced(
    flow: Callable[[Tensor, float | Tensor], Tensor], x: Tensor, dt: float | Tensor, half: Tensor
) -> tuple[Tensor, Tensor]:
    """Return states (B, D) after a step of a flow, and its Jacobians (B, D, D), by central differences.

    One call of the flow on B (1 + 2 D) states, for flows that cost more when they are followed.

    Args:
        flow: accurate to rounding.
        x: (B, D).
        dt: length of the step, or (B,) of each.
        half: (D,) half widths of the differences.
    """
    offsets = torch.diag(half).to(x)
    at = torch.cat((x.unsqueeze(1), x.unsqueeze(1) + offsets, x.unsqueeze(1) - offsets), dim=1)
    steps = dt.repeat_interleave(at.shape[1]) if isinstance(dt, Tensor) and dt.ndim else dt
    after = flow(at.flatten(0, 1), steps).unflatten(0, at.shape[:2])
    plus, minus = after[:, 1:].chunk(2, dim=1)
    return after[:, 0], ((plus - minus) / (2.0 * half.to(x).unsqueeze(-1))).mT
