"""Derivatives of dynamics with respect to their parameters."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.func import functional_call, jacrev, vmap

from ahnn.clock import reduced, split
from ahnn.dynamics.base import HasField
from ahnn.dynamics.forced import Forced, total
from ahnn.dynamics.forces import Instant
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
from ahnn.dynamics.separable_jacobian import (
    generic_rows,
    has_generic_rows,
    has_separable_rows,
    separable_rows,
)
from ahnn.types import TimeStep


class _Forward(nn.Module):
    """Wrapper whose forward pass is a function of a module, for `functional_call`."""

    def __init__(self, module: nn.Module, function: Callable[..., Tensor]) -> None:
        super().__init__()
        self.module = module
        self.function = function.__call__  # as a module it would register the parameters twice

    def forward(self, *arguments: Any) -> Tensor:
        return self.function(*arguments)


SWAPPED = threading.RLock()
"""Lock held while a module has substituted parameters, which other threads must not see."""


def parametrised(
    module: nn.Module, function: Callable[..., Tensor], dtype: torch.dtype
) -> Callable[..., Tensor]:
    """Return (theta, *arguments) -> function(*arguments), with theta as parameters of the module.

    Buffers are cast to `dtype`, so that a float64 module can be evaluated in float32.
    """
    wrapped = _Forward(module, function)
    shapes = {name: p.shape for name, p in wrapped.named_parameters()}
    sizes = [shape.numel() for shape in shapes.values()]
    buffers = {name: b.to(dtype) for name, b in wrapped.named_buffers()}

    def call(theta: Tensor, *arguments: Any) -> Tensor:
        parts = zip(shapes.items(), theta.split(sizes), strict=True)
        parameters = {name: part.view(shape) for (name, shape), part in parts}
        with SWAPPED:
            return functional_call(wrapped, {**parameters, **buffers}, arguments)

    return call


FieldJacobian = Callable[..., Tensor]
"""(theta (P,), x (..., D), factors (..., D) or none) -> factors df/dtheta, shape (..., L, P).

The rows are the last L components of the field f, which depend on theta: all, or only dp/dt if dq/dt is
known.
"""
IncrementJacobian = Callable[[Tensor, Tensor, TimeStep], tuple[Tensor, Tensor]]
"""(theta (P,), x (B, D), dt) -> d(increment)/dtheta, (B, D, P), and d(increment)/dx, (B, D, D)."""


def field_jacobian(dynamics: HasField, dtype: torch.dtype = torch.float32) -> FieldJacobian:
    """Return the Jacobian of the field, computed in `dtype`, in closed form where available."""
    field = dynamics.field
    if isinstance(field, Forced) and has_separable_rows(field.hamiltonian) and knows_velocities(field):
        return forced_field_jacobian(field, dtype)
    closed: Callable[..., Tensor]
    if has_generic_rows(field):
        closed = generic_rows
    elif has_separable_rows(field):
        closed = separable_rows
    else:
        return mapped_field_jacobian(dynamics, dtype)

    def jacobian(theta: Tensor, x: Tensor, factors: Tensor | None = None) -> Tensor:
        flat = x.flatten(0, -2).to(dtype)
        by = torch.ones_like(flat) if factors is None else factors.flatten(0, -2).to(dtype)
        return closed(field, theta.to(dtype), flat, by).unflatten(0, x.shape[:-1])

    return jacobian


def forced_field_jacobian(field: Forced, dtype: torch.dtype) -> FieldJacobian:
    """Return the Jacobian of a field with forces: p^2 / 2m + V(q) in closed form, forces by reverse mode.

    Velocities are known, so the forces do not depend on the parameters of V.
    """
    inner, clock = cast(SeparableHamiltonian, field.hamiltonian), field.clock
    count = sum(p.numel() for p in inner.parameters())

    def pushed(z: Tensor) -> Tensor:
        q, c, p, _ = split(z, clock)
        return total(field.parts, Instant(c[..., :1], c[..., 1:], q, inner.velocity(p)))

    of_forces = mapped_jacobian(field.forces, pushed, dtype)

    def jacobian(theta: Tensor, z: Tensor, factors: Tensor | None = None) -> Tensor:
        flat = z.flatten(0, -2).to(dtype)
        by = torch.ones_like(flat) if factors is None else factors.flatten(0, -2).to(dtype)
        plain, theta = reduced(by, clock), theta.to(dtype)
        rows = separable_rows(inner, theta[:count], reduced(flat, clock), plain)
        if len(theta) > count:
            rows = torch.cat((rows, of_forces(theta[count:], flat, plain.chunk(2, dim=-1)[1])), dim=-1)
        rows = nn.functional.pad(rows, (0, 0, 0, clock)) if clock else rows  # the clock has no parameters
        return rows.unflatten(0, z.shape[:-1])

    return jacobian


def mapped_field_jacobian(dynamics: HasField, dtype: torch.dtype = torch.float32) -> FieldJacobian:
    """Return the Jacobian of any field, by vectorised reverse mode."""
    half = knows_velocities(dynamics.field)

    def learned(x: Tensor) -> Tensor:
        return dynamics.field(x)[..., x.shape[-1] // 2 if half else 0 :]

    rows = mapped_jacobian(cast(nn.Module, dynamics), learned, dtype)

    def jacobian(theta: Tensor, x: Tensor, factors: Tensor | None = None) -> Tensor:
        flat = x.flatten(0, -2)
        by = torch.ones_like(flat) if factors is None else factors.flatten(0, -2)
        found = rows(theta, flat, by[:, x.shape[-1] // 2 if half else 0 :])
        return found.unflatten(0, x.shape[:-1])

    return jacobian


def mapped_jacobian(
    module: nn.Module, function: Callable[[Tensor], Tensor], dtype: torch.dtype = torch.float32
) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return (theta (P,), x (B, D), factors (B, R)) -> factors df/dtheta, (B, R, P), for any function f.

    Args:
        module: module whose parameters are theta.
        function: f, (B, D) -> (B, R), computed with the module.
        dtype: dtype of the computation.
    """
    single = parametrised(module, function, dtype)
    rows = vmap(
        jacrev(lambda theta, x: single(theta, x.unsqueeze(0)).squeeze(0)), (None, 0), chunk_size=20_000
    )

    def jacobian(theta: Tensor, x: Tensor, factors: Tensor) -> Tensor:
        return rows(theta.to(dtype), x.to(dtype)) * factors.to(dtype).unsqueeze(-1)

    return jacobian


def increment_jacobian(
    module: nn.Module, increment: Callable[[Tensor, TimeStep], Tensor], dtype: torch.dtype = torch.float32
) -> IncrementJacobian:
    """Return the Jacobian of a step by vectorised reverse mode, computed in `dtype`."""
    single = parametrised(module, increment, dtype)

    def of_sample(theta: Tensor, x: Tensor, dt: TimeStep) -> Tensor:
        step = dt.unsqueeze(0) if isinstance(dt, Tensor) else dt
        return single(theta, x.unsqueeze(0), step).squeeze(0)

    def jacobian(theta: Tensor, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        own = isinstance(dt, Tensor)
        rows = vmap(jacrev(of_sample, argnums=(0, 1)), (None, 0, 0 if own else None), chunk_size=20_000)
        return rows(theta.to(dtype), x.to(dtype), dt.to(dtype) if isinstance(dt, Tensor) else dt)

    return jacobian


def knows_velocities(field: nn.Module) -> bool:
    """Return whether T(p) is known, so that dq/dt is independent of all parameters."""
    inner = field.hamiltonian if isinstance(field, Forced) else field
    return isinstance(inner, SeparableHamiltonian) and not list(inner.kinetic.parameters())
