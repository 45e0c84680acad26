"""Batched Jacobians of functions that act on each member independently, by vectorised reverse mode."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.func import vjp, vmap

from ahnn.cores import each, slices

TOGETHER = 12_000
"""Number of state components whose Jacobians are formed at once, so that the work fits into the cache."""


def pointwise_jacobian(function: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Return df/dx, shape (..., M, D), of a function that maps each x (..., D) to its own f (..., M)."""
    # Adds zero times x: the process would crash if f did not depend on x (torch 2.13).
    along = lambda z: function(z) + 0.0 * z.sum(-1, keepdim=True)  # noqa: E731
    value, back = vjp(along, x)  # pyright: ignore[reportAssignmentType] - three values only with has_aux
    unit = torch.eye(value.shape[-1]).to(value)
    return vmap(lambda row: back(row.expand_as(value))[0], out_dims=-2)(unit)


def step_jacobians(increment: Callable[[Tensor, Tensor], Tensor], states: Tensor, lengths: Tensor) -> Tensor:
    """Return dx(t + dt)/dx(t) of each step, shape (B, N, D, D), of any flow.

    Args:
        increment: (x (B, D), dt (B,)) -> x(t + dt) - x(t), shape (B, D).
        states: (B, N, D) at the beginning of the steps.
        lengths: (B, N) step lengths.
    """
    x, dt = states.flatten(0, 1), lengths.flatten()

    def rows(part: slice) -> Tensor:
        return pointwise_jacobian(lambda z: z + increment(z, dt[part]), x[part])

    return torch.cat(each(rows, slices(len(x), TOGETHER // x.shape[1]), x.device)).unflatten(0, lengths.shape)


def moved(step: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """Return states (B, D) after one step and Jacobians (B, D, D); `step` propagates D variations of each."""
    beside = torch.eye(x.shape[1]).to(x).expand(len(x), -1, -1)
    after = step(torch.cat((x.unsqueeze(1), beside), dim=1))
    return after[:, 0], after[:, 1:].mT


def differenced(
    flow: Callable[[Tensor, float | Tensor], Tensor], x: Tensor, dt: float | Tensor, half: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the states (B, D) after one step of a flow and its Jacobians (B, D, D), by central differences.

    The flow is called once on B (1 + 2 D) states, for flows that are slower to differentiate by autograd.

    Args:
        flow: flow that is accurate to rounding.
        x: (B, D).
        dt: step length, or (B,) step lengths.
        half: (D,) half widths of the differences.
    """
    offsets = torch.diag(half).to(x)
    at = torch.cat((x.unsqueeze(1), x.unsqueeze(1) + offsets, x.unsqueeze(1) - offsets), dim=1)
    steps = dt.repeat_interleave(at.shape[1]) if isinstance(dt, Tensor) and dt.ndim else dt
    after = flow(at.flatten(0, 1), steps).unflatten(0, at.shape[:2])
    plus, minus = after[:, 1:].chunk(2, dim=1)
    return after[:, 0], ((plus - minus) / (2.0 * half.to(x).unsqueeze(-1))).mT
