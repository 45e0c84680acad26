"""Learned Hamiltonians of different structure, and their vector fields.

Each is a field x -> J grad H(x). The gradient is taken with respect to the physical state, so Hamilton's
equations hold exactly for any scaling of network inputs. Separable Hamiltonians provide `velocity` and
`force` for symplectic composition methods.
"""

from __future__ import annotations

from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from ahnn.arguments import Count, NonNegative, Positive, checked
from ahnn.dynamics import fused_steps
from ahnn.dynamics.energies import CentralBody, Energy, NetworkEnergy, Quadratic, energy_units
from ahnn.dynamics.energy_levels import divide_units
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.hessians import BothInputs, is_closed, network_derivatives
from ahnn.dynamics.inputs import Cartesian, InputName, ScaledStates, position_inputs
from ahnn.dynamics.layered import Network
from ahnn.dynamics.mass_matrix import MassMatrixHamiltonian
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.pair_potential import PairPotential
from ahnn.dynamics.scaling import Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics

Structure = Literal["generic", "separable", "mechanical", "central_body", "mass_matrix", "pairs"]


class GenericHamiltonian(ScaledStates):
    """H(q, p) as a single network, without structural assumptions.

    The arguments are those of `ScaledStates`, and the width, depth and activation of the network.
    """

    unit: Tensor

    def __init__(
        self, dof: int, network: dict[str, Any], inputs: InputName, scaling: Kind, angular: list[bool] | None
    ) -> None:
        super().__init__(dof, inputs, scaling, angular)
        self.network = make_network(self.positions.size + dof, 1, network)
        self.register_buffer("unit", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set all scalings from the training split."""
        super().fit(statistics)
        potential, kinetic = energy_units(statistics)
        self.unit.copy_((kinetic * potential).sqrt())
        divide_units(self.network, (self.positions, self.momenta), statistics)

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., F)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)

    @property
    def has_hessian(self) -> bool:
        """Whether the network's derivatives are available in closed form."""
        return is_closed(self.network)

    def derivatives(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return dH/dx, shape (B, D), and d2H/dx2, shape (B, D, D), at the states x, shape (B, D)."""
        inputs = BothInputs(self.positions, self.momenta)
        gradient, hessian = network_derivatives(self.network, inputs, x)
        return self.unit * gradient, self.unit * hessian

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        return self.unit * self.network(self.seen(x)).squeeze(-1)

    def layers(self, x: Tensor) -> Layers | None:
        """Return the network with scaling in its first layer, and unit and J in E: the field is delta_1 E.

        Returns None if the input map of the positions is not affine, the network is not layered, or
        computations with the states x need elementary operations.
        """
        positions, network = self.positions, self.network
        if not (isinstance(positions, Cartesian) and isinstance(network, Network)):
            return None
        if not fused_steps.applies(network.activation, x):
            return None
        maps, inner = (positions.affine, self.momenta.affine), network.layers()
        first = inner.weights[0] / torch.cat([m.scale for m in maps])
        shift = torch.cat([m.shift for m in maps])
        signed = torch.stack((self.unit, -self.unit)).repeat_interleave(len(shift) // 2)
        return Layers(
            [first, *inner.weights[1:]],
            [torch.addmv(inner.biases[0], first, shift, alpha=-1), *inner.biases[1:]],
            inner.last,
            first.roll(len(shift) // 2, 1) * signed,  # (dH/dp, -dH/dq) instead of (dH/dq, dH/dp)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), shape (..., D), at the states x, shape (..., D)."""
        if layers := self.layers(x):
            return fused_steps.network_gradient(x, layers, self.network.activation)
        q, p = x.chunk(2, dim=-1)
        (seen_q, of_q), (seen_p, of_p) = self.positions.linearised(q), self.momenta.linearised(p)
        gradient = self.unit * self.network.gradient(torch.cat((seen_q, seen_p), dim=-1))
        split = self.positions.size
        return torch.cat((of_p(gradient[..., split:]), -of_q(gradient[..., :split])), dim=-1)


class SeparableHamiltonian(nn.Module):
    """H = T(p) + V(q) with kinetic and potential energy each known or learned."""

    def __init__(self, kinetic: nn.Module, potential: nn.Module) -> None:
        super().__init__()
        self.kinetic, self.potential = kinetic, potential

    @property
    def energies(self) -> tuple[Energy, Energy]:
        """The energies T and V."""
        return cast(Energy, self.kinetic), cast(Energy, self.potential)

    @property
    def has_hessian(self) -> bool:
        """Whether the Hessians of T and V are available in closed form."""
        return all(getattr(energy, "has_hessian", False) for energy in self.energies)

    @property
    def has_rows(self) -> bool:
        """Whether the field's derivatives with respect to its parameters are available in closed form."""
        return all(getattr(energy, "has_rows", False) for energy in self.energies)

    def fit(self, statistics: Statistics) -> None:
        """Set all constants from the training split."""
        for energy in self.energies:
            energy.fit(statistics)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return self.kinetic(p) + self.potential(q)

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the learned energies, shape (..., F)."""
        q, p = x.chunk(2, dim=-1)
        kinetic, potential = self.energies
        return torch.cat((potential.seen(q), kinetic.seen(p)), dim=-1)

    def velocity(self, p: Tensor) -> Tensor:
        """Return dq/dt = dT/dp, shape (..., n)."""
        return self.energies[0].gradient(p)

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt = -dV/dq, shape (..., n)."""
        return -self.energies[1].gradient(q)

    def forward(self, x: Tensor) -> Tensor:
        """Return (dH/dp, -dH/dq), shape (..., D), at the states x, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.velocity(p), self.force(q)), dim=-1)


Hamiltonian = GenericHamiltonian | SeparableHamiltonian | MassMatrixHamiltonian


@checked
def make_hamiltonian(
    structure: Structure,
    dof: int,
    *,
    mass: Positive | list[Positive],
    mu: Positive | None,
    falloff: NonNegative = 0.0,
    dimensions: Count | None = None,
    inputs: InputName,
    scaling: Kind,
    network: dict[str, Any],
    angular: list[bool] | None = None,
) -> Hamiltonian:
    """Build a learned Hamiltonian of a given structure.

    Arguments as for `HamiltonianDynamics`, whose `hamiltonian` is the structure and `inertia` the mass.

    Raises:
        UserError: unknown structure, an option that the structure does not support, or a value out of range.
    """
    require_options(structure, dof, mu, falloff, dimensions)
    if dimensions is not None:
        own = {"dimensions": dimensions, "falloff": falloff, "network": network}
        return SeparableHamiltonian(Quadratic(mass), PairPotential(dof, mass, **own))
    if structure == "mass_matrix":
        return MassMatrixHamiltonian(dof, network, inputs, scaling, angular)
    if structure == "generic":
        return GenericHamiltonian(dof, network, inputs, scaling, angular)
    learned = NetworkEnergy(position_inputs(inputs, dof, scaling, angular), network, 0, falloff)
    if structure == "separable":
        return SeparableHamiltonian(NetworkEnergy(Cartesian(dof, scaling, 1), network, 1), learned)
    if structure == "mechanical":
        if isinstance(mass, list) and len(mass) != dof:
            message = f"inertia: expected one mass, or {dof}; received {mass}"
            raise UserError(message)
        return SeparableHamiltonian(Quadratic(mass), learned)
    if isinstance(mass, list):
        message = f"inertia: expected one mass for hamiltonian=central_body; received {mass}"
        raise UserError(message)
    return SeparableHamiltonian(Quadratic(mass), CentralBody(learned, mass, mu))


def require_options(
    structure: Structure, dof: int, mu: float | None, falloff: float, dimensions: int | None
) -> None:
    """Raise UserError for options that a structure does not support, or a required one that is missing."""
    if mu is not None and structure != "central_body":
        message = f"mu: expected None, since {structure} has no central body; received {mu}"
        raise UserError(message)
    if (dimensions is None) != (structure != "pairs"):
        expected = (
            "coordinates of a body" if structure == "pairs" else f"None, since {structure} has no bodies"
        )
        message = f"dimensions: expected {expected}; received {dimensions}"
        raise UserError(message)
    if structure == "central_body" and dof < 2:
        message = "hamiltonian central_body: expected at least 2 degrees of freedom; received 1"
        raise UserError(message)
    whole = structure in ("generic", "mass_matrix")
    if falloff and (whole or dof < 2):
        needs = f"0, since {structure} has no V(q)" if whole else "0 in one dimension"
        message = f"falloff: expected {needs}; received {falloff:g}"
        raise UserError(message)
