"""Fused steps of several fields as a single autograd operation, one field per core at a time.

A step of a small batch runs on one core, forwards and backwards. Steps of fields that share no parameters are
independent, so each core computes one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from ahnn.cores import each
from ahnn.dynamics import native
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.native import Scheme


def parallel_steps(starts: Sequence[Tensor], layers: Sequence[Layers], schemes: Sequence[Scheme]) -> Tensor:
    """Return the increments of one step along each of E fields, concatenated, shape (E B, D).

    Only first-order gradients are available.

    Args:
        starts: states of each field, (B, D).
        layers: layers of each field.
        schemes: method and step of each field.
    """
    given = [
        tensor for x, own in zip(starts, layers, strict=True) for tensor in (x.contiguous(), *own.tensors)
    ]
    found = _Steps.apply(schemes, *given)
    assert isinstance(found, Tensor)
    return found


def can_run(starts: Sequence[Tensor], layers: Sequence[Layers], schemes: Sequence[Scheme]) -> bool:
    """Return whether the C library supports the steps of all fields."""
    return all(
        native.applies(scheme, x.detach(), own.tensors)
        for x, own, scheme in zip(starts, layers, schemes, strict=True)
    )


class _Steps(Function):
    """Steps of E fields in one call; the tensors are the initial states and layer weights of each field."""

    @staticmethod
    def forward(ctx: Any, schemes: Sequence[Scheme], *given: Tensor) -> Tensor:
        ctx.schemes = schemes
        ctx.save_for_backward(*given)
        steps = _increments(schemes, given)
        ctx.rooms = [step.room() for step in steps] if any(ctx.needs_input_grad) else [None] * len(steps)
        device = given[0].device
        return torch.cat(each(lambda k: steps[k].follow(ctx.rooms[k]), range(len(steps)), device))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        steps, rooms = _increments(ctx.schemes, ctx.saved_tensors), ctx.rooms
        ctx.rooms = [None] * len(steps)  # overwritten by this pass
        pulls = cotangents[0].chunk(len(steps))
        device = pulls[0].device
        found = each(lambda k: steps[k].follow_back(pulls[k], rooms[k]), range(len(steps)), device)
        return None, *(tensor for moved, sums in found for tensor in (moved, *sums))


def _increments(schemes: Sequence[Scheme], given: Sequence[Tensor]) -> list[native.Increment]:
    """Return the step of each field."""
    size = len(given) // len(schemes)
    groups = (given[k : k + size] for k in range(0, len(given), size))
    return [native.Increment(scheme, x, own) for scheme, (x, *own) in zip(schemes, groups, strict=True)]
