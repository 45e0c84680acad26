"""Explicit Runge-Kutta steps along a network's gradient as a single autograd operation.

The backward pass of a step is written out, stage by stage, around the backward pass of the gradient. Autograd
then records one node per step instead of several hundred.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function

from ahnn.dynamics import native
from ahnn.dynamics.activations import Activation
from ahnn.dynamics.gradients import LayerRecord, Layers, gradient, plain_gradient, recorded_gradient, reverse
from ahnn.dynamics.native import Scheme
from ahnn.integrators.tableaus import EULER


def applies(activation: Activation, x: Tensor) -> bool:
    """Return whether x is a plain tensor and the activation has fused kernels.

    Function transforms (torch.func), graph capture, autocast and meta tensors need elementary operations.
    """
    return (
        activation.kernels is not None
        and not x.is_meta
        and not torch.compiler.is_compiling()
        and not torch._C._are_functorch_transforms_active()
        and not torch.is_autocast_enabled(x.device.type)
    )


def network_gradient(x: Tensor, layers: Layers, activation: Activation) -> Tensor:
    """Return the field f of `layers`, shape (..., F), at the inputs x, shape (..., F)."""
    flat = x.reshape(-1, x.shape[-1])
    return step(flat, layers, Scheme(EULER, 1.0, activation)).view_as(x)


def step(x: Tensor, layers: Layers, scheme: Scheme) -> Tensor:
    """Return the increment of one step, shape (B, D), along the field f of `layers`.

    Args:
        x: states, (B, D).
        layers: layers of f, as in `gradients`.
        scheme: method and step h, a number or a (B, 1) tensor.
    """
    tensors = layers.tensors
    if torch.is_grad_enabled() and isinstance(scheme.h, Tensor) and scheme.h.requires_grad:
        return plain_step(x, layers, scheme)
    if torch.is_grad_enabled() and any(t.requires_grad for t in (x, *tensors)):
        found = _Step.apply(scheme, x, *tensors)
        assert isinstance(found, Tensor)
        return found
    if native.applies(scheme, x, tensors):
        return native.Increment(scheme, x, tensors).follow()
    kernels = scheme.activation.kernels
    assert kernels is not None
    x, slopes = _by_columns(x), list[Tensor]()
    for row in ((), *scheme.tableau.a):
        slopes.append(gradient(moved(x, row, slopes, scheme.h), layers, kernels))
    return combined(scheme.tableau.b, slopes, scheme.h)


def plain_step(x: Tensor, layers: Layers, scheme: Scheme) -> Tensor:
    """Return the increment of `step` by elementary operations, differentiable to any order."""
    slopes: list[Tensor] = []
    for row in ((), *scheme.tableau.a):
        slopes.append(plain_gradient(moved(x, row, slopes, scheme.h), layers, scheme.activation))
    return combined(scheme.tableau.b, slopes, scheme.h)


def _by_columns(x: Tensor) -> Tensor:
    """Return x, (B, D), in column-major order, like the results of fields."""
    return x.T.contiguous().T


def combined(weights: tuple[float, ...], slopes: list[Tensor], h: float | Tensor) -> Tensor:
    """Return h sum_i weights_i slopes_i, skipping slopes of zero weight."""
    (first, slope), *others = [(w, k) for w, k in zip(weights, slopes, strict=True) if w != 0.0]
    by = 1.0 if isinstance(h, Tensor) else h
    total = slope * (first * by)
    for weight, other in others:
        total = total.add_(other, alpha=weight * by)
    return total * h if isinstance(h, Tensor) else total


def moved(x: Tensor, weights: tuple[float, ...], slopes: list[Tensor], h: float | Tensor) -> Tensor:
    """Return x + h sum_i weights_i slopes_i."""
    if isinstance(h, Tensor):
        return x + combined(weights, slopes, h) if weights else x
    for weight, slope in zip(weights, slopes, strict=True):
        if weight != 0.0:
            x = x.add(slope, alpha=weight * h)
    return x


def layers_of(tensors: Sequence[Tensor]) -> Layers:
    """Rebuild layers from their `tensors`."""
    depth = len(tensors) // 2 - 1
    return Layers(list(tensors[:depth]), list(tensors[depth:-2]), *tensors[-2:])


class _Step(Function):
    """`step` with gradients with respect to x and the tensors of the layers."""

    @staticmethod
    def forward(ctx: Any, scheme: Scheme, x: Tensor, *tensors: Tensor) -> Tensor:
        ctx.scheme = scheme
        ctx.save_for_backward(x, *tensors)
        ctx.native = native.applies(scheme, x, tensors)
        if ctx.native:
            step = native.Increment(scheme, x, tensors)
            ctx.room = step.room()
            return step.follow(ctx.room)
        layers, kernels = layers_of(tensors), scheme.activation.kernels
        assert kernels is not None
        x, slopes = _by_columns(x), list[Tensor]()
        records: list[list[LayerRecord]] = []
        for row in ((), *scheme.tableau.a):
            slope, record = recorded_gradient(moved(x, row, slopes, scheme.h), layers, kernels)
            slopes.append(slope)
            records.append(record)
        ctx.records = records
        return combined(scheme.tableau.b, slopes, scheme.h)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        x, *tensors = ctx.saved_tensors
        scheme, v = ctx.scheme, cotangents[0]
        plain = native.applies(scheme, v, (*tensors, x)) if ctx.native else torch._C._has_storage(v)
        if torch.is_grad_enabled() or not plain:  # second derivatives, or a vectorised pass
            with torch.enable_grad():
                return None, *_differentiable(ctx, v, (x, *tensors))
        if ctx.native:
            room, ctx.room = ctx.room, None
            moved_by, sums = native.Increment(scheme, x, tensors).follow_back(v, room)
            return None, moved_by, *sums
        layers, (a, b), h = layers_of(tensors), scheme.tableau, scheme.h
        sums, total = layers.zeros(), torch.zeros_like(x)
        later: list[Tensor] = [v]  # gradient of the increment, then of the stages in reverse order
        for i in reversed(range(len(b))):
            column = (b[i], *(row[i] for row in reversed(a[i:])))
            if not any(column):
                later.append(torch.zeros_like(total))
                continue
            moved_by = reverse(combined(column, later, h), ctx.records[i], layers, sums)
            total.add_(moved_by)
            later.append(moved_by)
        return None, total, *(w.T for w in sums.weights), *sums.biases, sums.last, sums.leave.T


def _differentiable(ctx: Any, v: Tensor, inputs: tuple[Tensor, ...]) -> list[Tensor | None]:
    """Return v . d(increment)/d(inputs), with a graph; None for inputs that require no gradient."""
    inputs = tuple(t.view_as(t) for t in inputs)  # treats the inputs as independent
    asked = [t for t, needed in zip(inputs, ctx.needs_input_grad[1:], strict=True) if needed]
    increment = plain_step(inputs[0], layers_of(inputs[1:]), ctx.scheme)
    found = iter(torch.autograd.grad(increment, asked, v, create_graph=True, allow_unused=True))
    return [next(found) if needed else None for needed in ctx.needs_input_grad[1:]]
