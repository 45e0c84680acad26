"""Known or learned energies: parts of a Hamiltonian that depend on positions or on momenta.

Each is a module with `fit` (constants from the training split), a value and a gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from ahnn.dynamics.energy_levels import divide_units
from ahnn.dynamics.hessians import is_closed, network_derivatives, point_mass_derivatives
from ahnn.dynamics.inputs import InputMap, slopes
from ahnn.dynamics.networks import make_network
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import as_factor

HIDDEN = 1.5
"""Rms of forces beyond a point mass, in standard deviations of their noise, below which it hides them."""
SLIGHT = 1e-3
"""Unit of a remainder that noise hides, relative to the potential of the point mass."""


class Energy(Protocol):
    """Function of the positions or of the momenta, with derivatives.

    `derivatives` requires `has_hessian`, and `write_rows` requires `has_rows`; reverse mode replaces them
    otherwise.
    """

    def fit(self, statistics: Statistics) -> None:
        """Set constants from the training split."""
        ...

    def __call__(self, q: Tensor) -> Tensor:
        """Return the energy, shape (...), at q, shape (..., n)."""
        ...

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient of the energy with respect to q, shape (..., n)."""
        ...

    def derivatives(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradient, shape (B, n), and the Hessian, shape (B, n, n), at q, shape (B, n)."""
        ...

    def write_rows(self, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
        """Write factors (B, n) times d(dE/dq)/dtheta to `out`, (B, n, P), for parameters theta, (P,)."""
        ...

    def seen(self, q: Tensor) -> Tensor:
        """Return the network inputs at q, shape (..., F); F = 0 where nothing is learned."""
        ...


def energy_units(statistics: Statistics) -> tuple[Tensor, Tensor]:
    """Return scales of V and T from the data: rms rate of one block times half the range of the other.

    In these units a network has inputs, outputs and gradients of order one.
    """
    rate_q, rate_p = statistics.rate.chunk(2)
    half_q, half_p = ((statistics.maximum - statistics.minimum) / 2).chunk(2)
    return (rate_p * half_q).mean(), (rate_q * half_p).mean()


class NetworkEnergy(nn.Module):
    """Network of mapped inputs, times an energy unit and an optional decay (R / r)^k.

    Args:
        inputs: map from the physical block to the network's inputs.
        network: width, depth, activation.
        block: 0 for a function of the positions, 1 for one of the momenta.
        falloff: decay exponent k with distance r from the origin; 0 for no prescribed decay.
    """

    unit: Tensor
    nearest: Tensor

    def __init__(self, inputs: InputMap, network: dict[str, Any], block: int, falloff: float = 0.0) -> None:
        super().__init__()
        self.inputs = inputs
        self.block = block
        self.falloff = falloff
        self.network = make_network(inputs.size, 1, network)
        self.register_buffer("unit", torch.ones(()))
        if falloff:
            self.register_buffer("nearest", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set the input map, the energy unit of the network's output, and R."""
        self.inputs.fit(statistics)
        self.unit.copy_(energy_units(statistics)[self.block])
        divide_units(self.network, (self.inputs,), statistics)
        if self.falloff:
            self.nearest.copy_(statistics.radius[0])

    def envelope(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return w = (R / r)^k, shape (..., 1), and grad log w, shape (..., n), at q, shape (..., n)."""
        square = q.square().sum(-1, keepdim=True)
        return (self.nearest.square() / square) ** (self.falloff / 2), q * (-self.falloff / square)

    def forward(self, q: Tensor) -> Tensor:
        """Return the energy, shape (...), at q, shape (..., n)."""
        found = self.network(self.inputs(q))
        if self.falloff:
            found = self.envelope(q)[0] * found
        return self.unit * found.squeeze(-1)

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient with respect to q, shape (..., n)."""
        z, pullback = self.inputs.linearised(q)
        slope = pullback(self.network.gradient(z))
        if self.falloff:
            weight, fall = self.envelope(q)
            slope = weight * (slope + fall * self.network(z))
        return self.unit * slope

    @property
    def has_hessian(self) -> bool:
        """Whether the network's derivatives are available in closed form."""
        return is_closed(self.network)

    @property
    def has_rows(self) -> bool:
        """Whether parameter derivatives are available in closed form; the inputs must have no parameters."""
        return is_closed(self.network) and not list(self.inputs.parameters())

    def derivatives(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradient, shape (B, n), and the Hessian, shape (B, n, n), at q, shape (B, n)."""
        gradient, hessian = network_derivatives(self.network, self.inputs, q)
        if self.falloff:  # derivatives of w N, w = (R / r)^k, from the derivatives of N
            value = self.network(self.inputs(q))
            weight, fall = self.envelope(q)  # w and f = grad log w = -k q / r^2
            square = q.square().sum(-1)[:, None, None]
            bent = -self.falloff / square * torch.eye(q.shape[1]).to(q)  # df/dq without the derivative of r
            bent = bent + (2 / self.falloff + 1) * fall.unsqueeze(-1) * fall.unsqueeze(-2)  # plus f f^T
            cross = fall.unsqueeze(-1) * gradient.unsqueeze(-2)
            hessian = weight.unsqueeze(-1) * (hessian + cross + cross.mT + value.unsqueeze(-1) * bent)
            gradient = weight * (gradient + fall * value)
        return self.unit * gradient, self.unit * hessian

    def write_rows(self, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
        """Write factors (B, n) times d(dE/dq)/dtheta to `out`, (B, n, P), for parameters theta, (P,)."""
        z, pullback = self.inputs.linearised(q)
        # dE/dq is linear in the network gradient: row i of each sample is a cotangent of that gradient.
        linear = slopes(z, pullback).mT
        factors, on_value = factors * self.unit, None
        if self.falloff:
            weight, fall = self.envelope(q)
            factors = factors * weight
            on_value = (factors * fall).to(theta)
        cotangents = factors.unsqueeze(-1) * linear
        self.network.write_rows(theta, z.to(theta), cotangents.to(theta), on_value, out)

    def seen(self, q: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., F)."""
        return self.inputs(q)


class Quadratic(nn.Module):
    """Kinetic energy p^2 / 2m with a known mass, common or per coordinate."""

    has_hessian = has_rows = True

    def __init__(self, mass: float | Sequence[float]) -> None:
        super().__init__()
        self.factor = as_factor(mass)  # not a buffer, to keep full precision for weights of any dtype

    def mass(self, like: Tensor) -> float | Tensor:
        """Return m as a number, or as a tensor (n,) with the dtype of `like`."""
        return self.factor.to(like) if isinstance(self.factor, Tensor) else self.factor

    def fit(self, statistics: Statistics) -> None:
        """Do nothing: there are no constants to set."""

    def forward(self, p: Tensor) -> Tensor:
        """Return p^2 / 2m, shape (...)."""
        if isinstance(self.factor, float):
            return (p * p).sum(-1) / (2 * self.factor)
        return 0.5 * (p * p / self.mass(p)).sum(-1)

    def gradient(self, p: Tensor) -> Tensor:
        """Return p / m, shape (..., n)."""
        return p / self.mass(p)

    def derivatives(self, p: Tensor) -> tuple[Tensor, Tensor]:
        """Return p / m, shape (B, n), and the matrix 1 / m, shape (B, n, n)."""
        return self.gradient(p), (torch.eye(p.shape[1]).to(p) / self.mass(p)).expand(len(p), -1, -1)

    def write_rows(self, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
        """Do nothing: there are no parameters."""

    def seen(self, p: Tensor) -> Tensor:
        """Return an empty tensor, shape (..., 0)."""
        return p[..., :0]


class CentralBody(nn.Module):
    """Potential -m mu / r of a body at the origin, plus a learned remainder.

    Args:
        remainder: learned perturbation of the point mass; the residual force of the data sets its unit.
        mass: mass m of the moving body.
        mu: gravitational parameter. If None, it is learned, starting from the median of estimates from
            individual force samples.
    """

    def __init__(self, remainder: NetworkEnergy, mass: float, mu: float | None) -> None:
        super().__init__()
        self.remainder = remainder
        self.mass = mass
        self.known_mu = mu
        if mu is None:
            self.log_mu = nn.Parameter(torch.zeros(()))

    @property
    def mu(self) -> Tensor | float:
        """Gravitational parameter; a known one keeps full precision for weights of any dtype."""
        return self.log_mu.exp() if self.known_mu is None else self.known_mu

    def constants(self) -> dict[str, Tensor]:
        """Return mu if it is learned."""
        return {"mu": self.log_mu.exp()} if self.known_mu is None else {}

    def fit(self, statistics: Statistics) -> None:
        """Set mu, if it is learned, and the unit of the remainder from the sampled forces.

        Raises:
            UserError: the data contain no attractive force.
        """
        self.remainder.fit(statistics)
        q, rate = statistics.positions, statistics.forces
        attraction = -self.mass * q / q.norm(dim=-1, keepdim=True) ** 3
        if self.known_mu is None:
            # The median is robust: noisy samples at low altitude give large, wrong forces.
            mu = ((attraction * rate).sum(-1) / attraction.square().sum(-1)).median()
            if not mu > 0:
                message = (
                    f"hamiltonian central_body: expected an attraction; received data with mu={float(mu):.3g}"
                )
                raise UserError(message)
            self.log_mu.data.copy_(mu.log())
        r, noise = q.norm(dim=-1, keepdim=True), statistics.force_sd
        left = (rate - self.mu * attraction) * r
        if noise is not None and left.square().mean() < HIDDEN**2 * (noise * r).square().mean():
            # A network in units of this noise could replace the attraction itself.
            left = SLIGHT * self.mu * attraction * r
        seen = self.remainder.envelope(q)[0] if self.remainder.falloff else torch.ones(1)
        self.remainder.unit.copy_((left.square().mean() / seen.square().mean()).sqrt())

    def forward(self, q: Tensor) -> Tensor:
        """Return the potential, shape (...), at q, shape (..., n)."""
        return self.remainder(q) - self.mass * self.mu / q.norm(dim=-1)

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient with respect to q, shape (..., n)."""
        r = q.norm(dim=-1, keepdim=True)
        return self.remainder.gradient(q) + (self.mass * self.mu / r**3) * q

    @property
    def has_hessian(self) -> bool:
        """Whether the derivatives of the remainder are available in closed form."""
        return self.remainder.has_hessian

    @property
    def has_rows(self) -> bool:
        """Whether derivatives with respect to its parameters are available in closed form."""
        return self.remainder.has_rows

    def derivatives(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradient, shape (B, n), and the Hessian, shape (B, n, n), at q, shape (B, n)."""
        gradient, hessian = self.remainder.derivatives(q)
        of_point = point_mass_derivatives(self.mass * self.mu, q)
        return gradient + of_point[0], hessian + of_point[1]

    def write_rows(self, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
        """Write factors (B, n) times d(dE/dq)/dtheta to `out`, (B, n, P), for parameters theta, (P,)."""
        if self.known_mu is None:
            attraction = self.mass * theta[0].exp() * q / q.norm(dim=-1, keepdim=True) ** 3
            out[..., 0] = factors * attraction
            theta, out = theta[1:], out[..., 1:]
        self.remainder.write_rows(theta, q, factors, out)

    def seen(self, q: Tensor) -> Tensor:
        """Return the network inputs of the remainder, shape (..., F)."""
        return self.remainder.seen(q)
