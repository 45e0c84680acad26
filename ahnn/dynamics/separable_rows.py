"""Jacobian of the field of H = T(p) + V(q) in closed form: of dp/dt, and of dq/dt where T is learned."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from ahnn.cores import each, slices
from ahnn.dynamics.energies import CentralBody, NetworkEnergy, Quadratic
from ahnn.dynamics.gradients import recorded_gradient
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
from ahnn.dynamics.inputs import slopes
from ahnn.dynamics.networks import Perceptron
from ahnn.dynamics.rows import layers_at, reversed_rows, with_value, write_rows

SAMPLES = 256
"""Samples whose rows are made at once."""


def has_separable_rows(field: nn.Module) -> bool:
    """Return whether the rows of this field are known in closed form."""
    if not isinstance(field, SeparableHamiltonian):
        return False
    kinetic = isinstance(field.kinetic, Quadratic) or _has_rows(field.kinetic)
    return kinetic and _has_rows(field.potential)


def _has_rows(energy: nn.Module) -> bool:
    inner = energy.remainder if isinstance(energy, CentralBody) else energy
    network = getattr(inner, "network", None)
    return (
        isinstance(inner, NetworkEnergy)
        and isinstance(network, Perceptron)
        and network.activation.kernels is not None
        and not list(inner.inputs.parameters())
    )


def separable_rows(field: SeparableHamiltonian, theta: Tensor, x: Tensor, factors: Tensor) -> Tensor:
    """Return factors df/dtheta of the components that theta moves, (B, L, P): L = D, or n where T is known.

    Args:
        field: for which `has_separable_rows`.
        theta: (P,).
        x: (B, D).
        factors: (B, D).
    """
    (q, p), (of_q, of_p) = x.chunk(2, dim=-1), factors.chunk(2, dim=-1)
    kinetic = sum(parameter.numel() for parameter in field.kinetic.parameters())
    size = x.shape[-1] if kinetic else q.shape[-1]
    out = x.new_empty(len(x), size, len(theta))

    def write(part: slice) -> None:
        rows = out[part]
        if not kinetic:
            _write(field.potential, theta, q[part], -of_p[part], rows)
            return
        rows.zero_()
        for block, energy, own, at, by in (
            (slice(0, size // 2), field.kinetic, slice(0, kinetic), p, of_q),
            (slice(size // 2, size), field.potential, slice(kinetic, None), q, -of_p),
        ):
            found = rows.new_empty(len(rows), size // 2, len(theta[own]))
            _write(energy, theta[own], at[part], by[part], found)
            rows[:, block, own] = found

    each(write, slices(len(x), SAMPLES, x.device), x.device)
    return out


def _write(energy: nn.Module, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
    """Write factors d(dV/dq)/dtheta of an energy V to `out`, (B, n, P)."""
    if isinstance(energy, CentralBody):
        if energy.known_mu is None:
            attraction = energy.mass * theta[0].exp() * q / q.norm(dim=-1, keepdim=True) ** 3
            out[..., 0] = factors * attraction
            theta, out = theta[1:], out[..., 1:]
        energy = energy.remainder
    network_energy = cast(NetworkEnergy, energy)
    z, pullback = network_energy.inputs.linearised(q)
    # dV/dq is linear in the gradient of the network: row i of each sample is a cotangent of it.
    linear = slopes(z, pullback).mT
    factors, on_value = factors * network_energy.unit, None
    if network_energy.falloff:
        weight, fall = network_energy.envelope(q)
        factors = factors * weight
        on_value = (factors * fall).to(theta)
    cotangents = factors.unsqueeze(-1) * linear
    network = cast(Perceptron, network_energy.network)
    layers, kernels = layers_at(network, theta), network.activation.kernels
    assert kernels is not None
    _, records = recorded_gradient(z.to(theta).T.contiguous().T, layers, kernels)
    stage, _ = reversed_rows(cotangents.to(theta), records, layers.weights)
    if on_value is None:
        write_rows([stage], out)
        return
    last = torch.addmm(layers.biases[-1], records[-1].entered, layers.weights[-1].T)
    write_rows([with_value(stage, on_value, kernels.value(last))], out)
    out[..., -1] = on_value
