"""Learned Hamiltonians: how much of H = T + V is assumed, and the field that follows from it.

Each is a field x -> J grad H(x) with the gradient taken with respect to the physical state, so Hamilton's
equations hold exactly whatever scaling its networks use. The separable ones offer `velocity` and `force` and
may be integrated by symplectic compositions.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn

from ahnn.errors import UserError
from ahnn.models.inputs import Cartesian, InputMap, InputName, position_inputs
from ahnn.models.networks import make_network
from ahnn.normalisation import Kind, Statistics

Structure = Literal["generic", "separable", "mechanical"]


class ScalarField(nn.Module):
    """An energy of one block of the state: a network behind an input map, times an energy scale.

    Args:
        inputs: map from the physical block to the network's inputs.
        network: options of the MLP: width, depth, activation.
    """

    unit: Tensor

    def __init__(self, inputs: InputMap, network: dict[str, Any]) -> None:
        super().__init__()
        self.inputs = inputs
        self.network = make_network(inputs.size, 1, network)
        self.register_buffer("unit", torch.ones(()))

    def fit(self, statistics: Statistics, unit: Tensor) -> None:
        """Set the input map and the energy in which the network's output is measured."""
        self.inputs.fit(statistics)
        self.unit.copy_(unit)

    def forward(self, q: Tensor) -> Tensor:
        """Return the energy, shape (...), at q, shape (..., n)."""
        return self.unit * self.network(self.inputs(q)).squeeze(-1)

    def gradient(self, q: Tensor) -> Tensor:
        """Return the gradient of the energy with respect to q, shape (..., n)."""
        return self.unit * self.inputs.pullback(q, self.network.gradient(self.inputs(q)))


def energy_units(statistics: Statistics) -> tuple[Tensor, Tensor]:
    """Return the sizes of T and V implied by the data: rms rate of one block times half range of the other.

    A network whose output is measured in these units has inputs, outputs and gradients of order one.
    """
    rate_q, rate_p = statistics.rate.chunk(2)
    half_q, half_p = ((statistics.maximum - statistics.minimum) / 2).chunk(2)
    return (rate_q * half_p).mean(), (rate_p * half_q).mean()


class GenericHamiltonian(nn.Module):
    """H(q, p) from one network: nothing is assumed.

    Args:
        dof: degrees of freedom n.
        inputs: cartesian or isotropic, for the positions.
        scaling: minmax, block or none.
        network: width, depth, activation.
    """

    unit: Tensor

    def __init__(self, dof: int, *, inputs: InputName, scaling: Kind, network: dict[str, Any]) -> None:
        super().__init__()
        self.positions = position_inputs(inputs, dof, scaling)
        self.momenta = Cartesian(dof, scaling, 1)
        self.network = make_network(self.positions.size + dof, 1, network)
        self.register_buffer("unit", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set all scalings from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        kinetic, potential = energy_units(statistics)
        self.unit.copy_((kinetic * potential).sqrt())

    def _inputs(self, q: Tensor, p: Tensor) -> Tensor:
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        return self.unit * self.network(self._inputs(*x.chunk(2, dim=-1))).squeeze(-1)

    def forward(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), shape (..., D), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        gradient = self.unit * self.network.gradient(self._inputs(q, p))
        split = self.positions.size
        dq = self.momenta.pullback(p, gradient[..., split:])
        return torch.cat((dq, -self.positions.pullback(q, gradient[..., :split])), dim=-1)


class SeparableHamiltonian(nn.Module):
    """H = T(p) + V(q) from one or two networks.

    Args:
        dof: degrees of freedom n.
        inputs, scaling, network: as for `GenericHamiltonian`, for T and V alike.
        mass: None learns T(p); a number sets T = p^2 / 2m, the `mechanical` structure.
    """

    def __init__(
        self,
        dof: int,
        *,
        inputs: InputName,
        scaling: Kind,
        network: dict[str, Any],
        mass: float | None = None,
    ) -> None:
        super().__init__()
        self.mass = mass
        self.kinetic = None if mass else ScalarField(Cartesian(dof, scaling, 1), network)
        self.potential = ScalarField(position_inputs(inputs, dof, scaling), network)

    def fit(self, statistics: Statistics) -> None:
        """Set all scalings from the training split."""
        kinetic, potential = energy_units(statistics)
        if self.kinetic is not None:
            self.kinetic.fit(statistics, kinetic)
        self.potential.fit(statistics, potential)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        kinetic = self.kinetic(p) if self.kinetic is not None else (p * p).sum(-1) / (2 * self._known_mass)
        return kinetic + self.potential(q)

    def velocity(self, p: Tensor) -> Tensor:
        """Return dq/dt = dT/dp, shape (..., n)."""
        return self.kinetic.gradient(p) if self.kinetic is not None else p / self._known_mass

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt = -dV/dq, shape (..., n)."""
        return -self.potential.gradient(q)

    def forward(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), shape (..., D), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.velocity(p), self.force(q)), dim=-1)

    @property
    def _known_mass(self) -> float:
        assert self.mass is not None
        return self.mass


Hamiltonian = GenericHamiltonian | SeparableHamiltonian


def make_hamiltonian(
    structure: Structure,
    dof: int,
    *,
    mass: float,
    inputs: InputName,
    scaling: Kind,
    network: dict[str, Any],
) -> Hamiltonian:
    """Return the learned Hamiltonian of a structure.

    Args:
        structure: `generic` H(q, p), `separable` T(p) + V(q), or `mechanical` p^2 / 2m + V(q).
        dof: degrees of freedom n.
        mass: used by `mechanical` alone.
        inputs: cartesian or isotropic, for the positions.
        scaling: minmax, block or none.
        network: width, depth, activation.

    Raises:
        UserError: unknown structure.
    """
    if structure == "generic":
        return GenericHamiltonian(dof, inputs=inputs, scaling=scaling, network=network)
    if structure not in get_args(Structure):
        message = f"hamiltonian: expected one of {', '.join(get_args(Structure))}; received {structure!r}"
        raise UserError(message)
    known = mass if structure == "mechanical" else None
    return SeparableHamiltonian(dof, inputs=inputs, scaling=scaling, network=network, mass=known)
