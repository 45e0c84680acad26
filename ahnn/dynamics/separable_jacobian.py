"""Closed-form parameter Jacobians of the fields of H(q, p) and T(p) + V(q)."""

from __future__ import annotations

from typing import TypeGuard

import torch
from torch import Tensor, nn

from ahnn.cores import each, slices
from ahnn.dynamics.hamiltonians import GenericHamiltonian, SeparableHamiltonian
from ahnn.dynamics.hessians import BothInputs
from ahnn.dynamics.inputs import slopes

SAMPLES = 256
"""Number of samples whose rows are computed at once."""


def has_separable_rows(field: nn.Module) -> TypeGuard[SeparableHamiltonian]:
    """Return whether a field is separable and has closed-form parameter derivatives."""
    return isinstance(field, SeparableHamiltonian) and field.has_rows


def separable_rows(field: SeparableHamiltonian, theta: Tensor, x: Tensor, factors: Tensor) -> Tensor:
    """Return factors df/dtheta, (B, L, P), of the L components that depend on theta: L = D, or n for known T.

    Args:
        field: field with `has_separable_rows`.
        theta: (P,).
        x: (B, D).
        factors: (B, D).
    """
    momenta, potential = field.energies
    (q, p), (of_q, of_p) = x.chunk(2, dim=-1), factors.chunk(2, dim=-1)
    kinetic = sum(parameter.numel() for parameter in field.kinetic.parameters())
    size = x.shape[-1] if kinetic else q.shape[-1]
    out = x.new_empty(len(x), size, len(theta))

    def write(part: slice) -> None:
        rows = out[part]
        if not kinetic:
            potential.write_rows(theta, q[part], -of_p[part], rows)
            return
        rows.zero_()
        for block, energy, own, at, by in (
            (slice(0, size // 2), momenta, slice(0, kinetic), p, of_q),
            (slice(size // 2, size), potential, slice(kinetic, None), q, -of_p),
        ):
            found = rows.new_empty(len(rows), size // 2, len(theta[own]))
            energy.write_rows(theta[own], at[part], by[part], found)
            rows[:, block, own] = found

    each(write, slices(len(x), SAMPLES, x.device), x.device)
    return out


def has_generic_rows(field: nn.Module) -> TypeGuard[GenericHamiltonian]:
    """Return whether a field is defined by a single network with closed-form derivatives."""
    return isinstance(field, GenericHamiltonian) and field.has_hessian


def generic_rows(field: GenericHamiltonian, theta: Tensor, x: Tensor, factors: Tensor) -> Tensor:
    """Return factors df/dtheta, (B, D, P).

    Args:
        field: field with `has_generic_rows`.
        theta: (P,).
        x: (B, D).
        factors: (B, D).
    """
    out, inputs = x.new_empty(*x.shape, len(theta)), BothInputs(field.positions, field.momenta)

    def write(part: slice) -> None:
        z, pullback = inputs.linearised(x[part])
        # dH/dx is linear in the gradient of the network, and f = (dH/dp, -dH/dq).
        of_q, of_p = slopes(z, pullback).mT.chunk(2, dim=1)
        linear = field.unit * torch.cat((of_p, -of_q), dim=1) * factors[part].unsqueeze(-1)
        field.network.write_rows(theta, z.to(theta), linear.to(theta), None, out[part])

    each(write, slices(len(x), SAMPLES, x.device), x.device)
    return out
