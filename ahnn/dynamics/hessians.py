"""Gradients and Hessians of learned energies with respect to the coordinates, in closed form.

Of E(x) = u N(z(x)): dz/dx^T N_zz dz/dx, and the change of dz/dx along the gradient of N.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ahnn.dynamics.energies import CentralBody, NetworkEnergy, Quadratic
from ahnn.dynamics.gradients import recorded_gradient
from ahnn.dynamics.hamiltonians import GenericHamiltonian
from ahnn.dynamics.inputs import Cartesian, InputMap, Pullback, slopes
from ahnn.dynamics.networks import Perceptron
from ahnn.dynamics.rows import curvature


def has_hessian(energy: nn.Module) -> bool:
    """Return whether the Hessian of this energy, or generic Hamiltonian, is known in closed form."""
    if isinstance(energy, Quadratic):
        return True
    if isinstance(energy, CentralBody):
        energy = energy.remainder
    if not isinstance(energy, NetworkEnergy | GenericHamiltonian):
        return False
    return isinstance(energy.network, Perceptron) and energy.network.activation.kernels is not None


@torch.no_grad()
def gradient_and_hessian(energy: nn.Module, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return dE/dx, shape (B, D), and d2E/dx2, shape (B, D, D), at x, shape (B, D).

    Args:
        energy: for which `has_hessian`, in the precision of x.
        x: positions, momenta, or states of a generic Hamiltonian.
    """
    if isinstance(energy, CentralBody):
        gradient, hessian = gradient_and_hessian(energy.remainder, x)
        of_point = _point_mass(energy.mass * energy.mu, x)
        return gradient + of_point[0], hessian + of_point[1]
    if isinstance(energy, Quadratic):
        return energy.gradient(x), (torch.eye(x.shape[1]).to(x) / energy.mass(x)).expand(len(x), -1, -1)
    if isinstance(energy, GenericHamiltonian):
        gradient, hessian = _of_network(energy.network, _Both(energy.positions, energy.momenta), x)
        return energy.unit * gradient, energy.unit * hessian
    assert isinstance(energy, NetworkEnergy)
    gradient, hessian = _of_network(energy.network, energy.inputs, x)
    if energy.falloff:
        gradient, hessian = _falling(energy, x, gradient, hessian)
    return energy.unit * gradient, energy.unit * hessian


def _point_mass(strength: Tensor | float, q: Tensor) -> tuple[Tensor, Tensor]:
    """Return the derivatives of -strength / r."""
    r = q.norm(dim=-1, keepdim=True)
    direction = (q / r).unsqueeze(-1)
    by = strength / r**3
    return by * q, by.unsqueeze(-1) * (torch.eye(q.shape[1]).to(q) - 3 * direction @ direction.mT)


class _Both(NamedTuple):
    """Input maps of positions and momenta as one of states."""

    positions: InputMap
    momenta: Cartesian

    def linearised(self, x: Tensor) -> tuple[Tensor, Pullback]:
        """Return z at x and the way back of gradients from there."""
        q, p = x.chunk(2, dim=-1)
        (seen_q, back_q), (seen_p, back_p) = self.positions.linearised(q), self.momenta.linearised(p)
        split = seen_q.shape[-1]

        def pullback(gradient: Tensor) -> Tensor:
            return torch.cat((back_q(gradient[..., :split]), back_p(gradient[..., split:])), dim=-1)

        return torch.cat((seen_q, seen_p), dim=-1), pullback

    def curvature(self, x: Tensor, gradient: Tensor) -> Tensor:
        """Return the second derivative of z along the gradient with respect to it, (B, D, D)."""
        n = x.shape[-1] // 2
        found = x.new_zeros(*x.shape, 2 * n)
        found[..., :n, :n] = self.positions.curvature(x[..., :n], gradient[..., : self.positions.size])
        return found  # the momenta enter by an affine map


def _of_network(network: Perceptron, inputs: InputMap | _Both, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the derivatives of N by x, (B, D) and (B, D, D)."""
    z, pullback = inputs.linearised(x)
    kernels = network.activation.kernels
    assert kernels is not None
    layers = network.layers()
    gradient, records = recorded_gradient(z.T.contiguous().T, layers, kernels)
    moved = slopes(z, pullback)
    second = moved.mT @ curvature(records, layers.weights) @ moved
    return pullback(gradient), second + inputs.curvature(x, gradient)


def _falling(energy: NetworkEnergy, q: Tensor, gradient: Tensor, hessian: Tensor) -> tuple[Tensor, Tensor]:
    """Return the derivatives of w N, w = (R / r)^k, from those of N."""
    value = energy.network(energy.inputs(q))
    weight, fall = energy.envelope(q)  # w and f = grad log w = -k q / r^2
    square = q.square().sum(-1)[:, None, None]
    bent = -energy.falloff / square * torch.eye(q.shape[1]).to(q)  # df/dq, but for the change of r
    bent = bent + (2 / energy.falloff + 1) * fall.unsqueeze(-1) * fall.unsqueeze(-2)  # and f f^T
    cross = fall.unsqueeze(-1) * gradient.unsqueeze(-2)
    curved = hessian + cross + cross.mT + value.unsqueeze(-1) * bent
    return weight * (gradient + fall * value), weight.unsqueeze(-1) * curved
