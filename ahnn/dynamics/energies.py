"""Parts of a Hamiltonian that depend on one block of the state, known or learned.

Each is a module with `fit` (constants from the training split), a value and a gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from ahnn.dynamics.inputs import InputMap
from ahnn.dynamics.networks import make_network
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import as_factor


class Energy(Protocol):
    """A function of the positions or of the momenta with its gradient."""

    def fit(self, statistics: Statistics) -> None:
        """Set constants from the training split."""
        ...

    def __call__(self, q: Tensor) -> Tensor:
        """Return the energy, shape (...), at q, shape (..., n)."""
        ...

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient of the energy with respect to q, shape (..., n)."""
        ...

    def seen(self, q: Tensor) -> Tensor:
        """Return what its network sees of q, shape (..., F); F = 0 where nothing is learned."""
        ...


def energy_units(statistics: Statistics) -> tuple[Tensor, Tensor]:
    """Return the sizes of V and T implied by the data: rms rate of one block times half range of the other.

    A network whose output is measured in these units has inputs, outputs and gradients of order one.
    """
    rate_q, rate_p = statistics.rate.chunk(2)
    half_q, half_p = ((statistics.maximum - statistics.minimum) / 2).chunk(2)
    return (rate_p * half_q).mean(), (rate_q * half_p).mean()


class NetworkEnergy(nn.Module):
    """A network behind an input map, times an energy unit and, where it falls, (R / r)^k.

    Args:
        inputs: map from the physical block to the network's inputs.
        network: width, depth, activation.
        block: 0 for a function of the positions, 1 for one of the momenta.
        falloff: k; 0 leaves open how the energy goes with the distance r from the origin.
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
        """Set the input map, the energy in which the network's output is measured, and R."""
        self.inputs.fit(statistics)
        self.unit.copy_(energy_units(statistics)[self.block])
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

    def seen(self, q: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., F)."""
        return self.inputs(q)


class Quadratic(nn.Module):
    """The kinetic energy p^2 / 2m of a known mass, or of one for each coordinate."""

    def __init__(self, mass: float | Sequence[float]) -> None:
        super().__init__()
        self.factor = as_factor(mass)  # no buffer: it keeps all its digits in any precision of the weights

    def mass(self, like: Tensor) -> float | Tensor:
        """Return m: a number, or (n,) of the type of a tensor."""
        return self.factor.to(like) if isinstance(self.factor, Tensor) else self.factor

    def fit(self, statistics: Statistics) -> None:
        """Nothing to set."""

    def forward(self, p: Tensor) -> Tensor:
        """Return p^2 / 2m, shape (...)."""
        if isinstance(self.factor, float):
            return (p * p).sum(-1) / (2 * self.factor)
        return 0.5 * (p * p / self.mass(p)).sum(-1)

    def gradient(self, p: Tensor) -> Tensor:
        """Return p / m, shape (..., n)."""
        return p / self.mass(p)

    def seen(self, p: Tensor) -> Tensor:
        """Return nothing, shape (..., 0)."""
        return p[..., :0]


class CentralBody(nn.Module):
    """The potential -m mu / r of a body at the origin, plus a learned remainder.

    Args:
        remainder: what a point mass does not explain; its unit is set to what is left of the data.
        mass: m, of the moving body.
        mu: gravitational parameter; None learns it, beginning with the median of what single forces say.
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
        """The gravitational parameter; a known one keeps all its digits in any precision of the weights."""
        return self.log_mu.exp() if self.known_mu is None else self.known_mu

    def fit(self, statistics: Statistics) -> None:
        """Set mu, if it is learned, and the unit of the remainder from the sampled forces.

        Raises:
            UserError: the data show no attraction.
        """
        self.remainder.fit(statistics)
        q, rate = statistics.positions, statistics.forces
        attraction = -self.mass * q / q.norm(dim=-1, keepdim=True) ** 3
        if self.known_mu is None:
            # The median: where an orbit is low, forces are large, and those read off noisy samples wrong.
            mu = ((attraction * rate).sum(-1) / attraction.square().sum(-1)).median()
            if not mu > 0:
                message = (
                    "hamiltonian central_body: expected an attraction; received data "
                    f"that give mu={float(mu):.3g}"
                )
                raise UserError(message)
            self.log_mu.data.copy_(mu.log())
        left = (rate - self.mu * attraction) * q.norm(dim=-1, keepdim=True)
        seen = self.remainder.envelope(q)[0] if self.remainder.falloff else torch.ones(1)
        self.remainder.unit.copy_((left.square().mean() / seen.square().mean()).sqrt())

    def forward(self, q: Tensor) -> Tensor:
        """Return the potential, shape (...), at q, shape (..., n)."""
        return self.remainder(q) - self.mass * self.mu / q.norm(dim=-1)

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient with respect to q, shape (..., n)."""
        r = q.norm(dim=-1, keepdim=True)
        return self.remainder.gradient(q) + (self.mass * self.mu / r**3) * q

    def seen(self, q: Tensor) -> Tensor:
        """Return what the remainder sees, shape (..., F)."""
        return self.remainder.seen(q)
