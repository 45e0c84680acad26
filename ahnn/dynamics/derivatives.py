"""Derivatives of dynamics with respect to their parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.func import functional_call, jacrev, vmap

from ahnn.dynamics.base import HasField
from ahnn.dynamics.hamiltonians import SeparableHamiltonian


class _Forward(nn.Module):
    """A function of a module as a forward pass, which `functional_call` can parametrise."""

    def __init__(self, module: nn.Module, function: Callable[..., Tensor]) -> None:
        super().__init__()
        self.module, self.function = module, function

    def forward(self, *arguments: Any) -> Tensor:
        return self.function(*arguments)


def parametrised(
    module: nn.Module, function: Callable[..., Tensor], dtype: torch.dtype
) -> Callable[..., Tensor]:
    """Return (theta, *arguments) -> function(*arguments), with theta as the module's parameters.

    Buffers are used in `dtype`, so that a float64 module can be evaluated in float32.
    """
    wrapped = _Forward(module, function)
    shapes = {name: p.shape for name, p in wrapped.named_parameters()}
    sizes = [shape.numel() for shape in shapes.values()]
    buffers = {name: b.to(dtype) for name, b in wrapped.named_buffers()}

    def call(theta: Tensor, *arguments: Any) -> Tensor:
        parts = zip(shapes.items(), theta.split(sizes), strict=True)
        parameters = {name: part.view(shape) for (name, shape), part in parts}
        return functional_call(wrapped, {**parameters, **buffers}, arguments)

    return call


def field_jacobian(dynamics: HasField) -> Callable[[Tensor, Tensor], Tensor]:
    """Return (theta (P,), x (..., D)) -> df/dtheta, float32, of the components of the field f that theta moves.

    They are the last L, shape (..., L, P): all of them, or dp/dt alone where dq/dt is known.
    """
    half = knows_velocities(dynamics.field)

    def learned(x: Tensor) -> Tensor:
        return dynamics.field(x)[..., x.shape[-1] // 2 if half else 0 :]

    field = parametrised(cast(nn.Module, dynamics), learned, torch.float32)
    single = lambda theta, x: field(theta, x.unsqueeze(0)).squeeze(0)  # noqa: E731
    rows = vmap(jacrev(single), (None, 0), chunk_size=20_000)
    return lambda theta, x: rows(theta.float(), x.float().flatten(0, -2)).unflatten(0, x.shape[:-1])


def knows_velocities(field: nn.Module) -> bool:
    """Return whether no parameter moves dq/dt: T(p) is known."""
    return isinstance(field, SeparableHamiltonian) and not list(field.kinetic.parameters())
