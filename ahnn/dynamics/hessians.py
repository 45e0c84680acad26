"""Closed-form gradients and Hessians of networks composed with input maps.

The Hessian of N(z(x)) is dz/dx^T N_zz dz/dx plus the derivative of dz/dx contracted with grad N.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeGuard

import torch
from torch import Tensor, nn

from ahnn.dynamics.gradients import recorded_gradient
from ahnn.dynamics.inputs import Cartesian, InputMap, Pullback, slopes
from ahnn.dynamics.layered import Network
from ahnn.dynamics.parameter_jacobians import curvature


class Inputs(Protocol):
    """Input map z(x) with known derivatives."""

    def linearised(self, x: Tensor, /) -> tuple[Tensor, Pullback]:
        """Return z at x and the pullback of gradients at that point."""
        ...

    def curvature(self, x: Tensor, gradient: Tensor, /) -> Tensor:
        """Return the second derivative of z contracted with the gradient with respect to z, (B, D, D)."""
        ...


class BothInputs(NamedTuple):
    """Input maps of positions and momenta, combined into one map of states."""

    positions: InputMap
    momenta: Cartesian

    def linearised(self, x: Tensor) -> tuple[Tensor, Pullback]:
        """Return z at x and the pullback of gradients at that point."""
        q, p = x.chunk(2, dim=-1)
        (seen_q, back_q), (seen_p, back_p) = self.positions.linearised(q), self.momenta.linearised(p)
        split = seen_q.shape[-1]

        def pullback(gradient: Tensor) -> Tensor:
            return torch.cat((back_q(gradient[..., :split]), back_p(gradient[..., split:])), dim=-1)

        return torch.cat((seen_q, seen_p), dim=-1), pullback

    def curvature(self, x: Tensor, gradient: Tensor) -> Tensor:
        """Return the second derivative of z contracted with the gradient with respect to z, (B, D, D)."""
        n = x.shape[-1] // 2
        found = x.new_zeros(*x.shape, 2 * n)
        found[..., :n, :n] = self.positions.curvature(x[..., :n], gradient[..., : self.positions.size])
        return found  # the momenta enter by an affine map


def is_closed(network: nn.Module) -> TypeGuard[Network]:
    """Return whether a network's derivatives are available in closed form."""
    return isinstance(network, Network) and network.activation.kernels is not None


def network_derivatives(network: nn.Module, inputs: Inputs, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return dN/dx, (B, D), and d2N/dx2, (B, D, D), of a network that satisfies `is_closed`."""
    assert is_closed(network)
    z, pullback = inputs.linearised(x)
    kernels = network.activation.kernels
    assert kernels is not None
    layers = network.layers()
    gradient, records = recorded_gradient(z.T.contiguous().T, layers, kernels)
    moved = slopes(z, pullback)
    second = moved.mT @ curvature(records, layers.weights) @ moved
    return pullback(gradient), second + inputs.curvature(x, gradient)


def point_mass_derivatives(strength: Tensor | float, q: Tensor) -> tuple[Tensor, Tensor]:
    """Return the gradient, (B, n), and the Hessian, (B, n, n), of -strength / r."""
    r = q.norm(dim=-1, keepdim=True)
    direction = (q / r).unsqueeze(-1)
    by = strength / r**3
    return by * q, by.unsqueeze(-1) * (torch.eye(q.shape[1]).to(q) - 3 * direction @ direction.mT)
