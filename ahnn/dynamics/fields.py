"""Dynamics defined by a vector field and a one-step integrator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast, final

import torch
from torch import Tensor, nn

from ahnn.dynamics import fused_steps, native
from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.forced import Forced
from ahnn.dynamics.forces import Force
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.hamiltonians import GenericHamiltonian, Structure, make_hamiltonian
from ahnn.dynamics.inputs import Cartesian, InputName
from ahnn.dynamics.layered import silence
from ahnn.dynamics.native import Scheme
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.scaling import Kind
from ahnn.integrators import ExplicitRungeKutta, column, make_integrator
from ahnn.statistics import Statistics
from ahnn.types import TimeStep


class NeuralField(nn.Module):
    """Network for dx/dt, in units of the typical rate of each component.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        network: width, depth, activation.
    """

    rate: Tensor

    def __init__(self, dof: int, scaling: Kind, network: dict[str, Any]) -> None:
        super().__init__()
        self.positions, self.momenta = Cartesian(dof, scaling, 0), Cartesian(dof, scaling, 1)
        self.network = make_network(2 * dof, 2 * dof, network)
        self.register_buffer("rate", torch.ones(2 * dof))

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and rates from the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
        self.rate.copy_(statistics.rate)

    def seen(self, x: Tensor) -> Tensor:
        """Return the inputs of the network, shape (..., D)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.positions(q), self.momenta(p)), dim=-1)

    def forward(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D)."""
        return self.rate * self.network(self.seen(x))


class IntegratedField(Dynamics):
    """Vector field integrated by a one-step method."""

    def __init__(self, field: nn.Module, integrator: dict[str, Any]) -> None:
        super().__init__()
        self.field = field
        self.integrator = make_integrator(**integrator)
        self.integrator.require(self.field)

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and units from the training split."""
        cast(Any, self.field).fit(statistics)

    def seen(self, x: Tensor) -> Tensor:
        """Return the network inputs of the field, shape (..., F)."""
        return cast(Any, self.field).seen(x)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the integrator's increment along the field, shape (B, D)."""
        return self.integrator.increment(self.field, x, dt)


@final
class NeuralDynamics(IntegratedField):
    """Neural ordinary differential equation (Chen et al. 2018).

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.
    """

    assumes = "no Hamiltonian"
    anchored = False

    def __init__(
        self, dof: int, *, scaling: Kind, network: dict[str, Any], integrator: dict[str, Any]
    ) -> None:
        super().__init__(NeuralField(dof, scaling, network), integrator)


MOVES = ("mechanical", "central_body", "pairs")
"""Hamiltonians with known kinetic energy, which describe a motion even without the learned part."""
CENTRED = ("isotropic", "radial", "central_body")
"""Input maps and Hamiltonians that assume a force centre at the origin."""


@final
class HamiltonianDynamics(IntegratedField):
    """Hamilton's equations with a learned Hamiltonian.

    Args:
        dof: degrees of freedom n.
        inertia: factor m of T = p^2 / 2m, for `mechanical`, `pairs` and `central_body`; a number, or one per
            coordinate except for `central_body`.
        hamiltonian: `generic` H(q, p), `separable` T(p) + V(q), `mechanical` p^2 / 2m + V(q), `central_body`
            p^2 / 2m - m mu / r + V(q), `mass_matrix` p^T M(q)^{-1} p / 2 + V(q), or `pairs` p^2 / 2m plus a
            potential of the distances between bodies.
        mu: gravitational parameter of `central_body`; None to learn it.
        falloff: k of a learned V(q) = (R / r)^k N(q); 0 for no prescribed decay with distance.
        dimensions: number of coordinates per body, for `pairs`.
        inputs: cartesian, isotropic or radial positions, or angles.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.
        angular: which coordinates are angles, for inputs=angles.
        forces: additional forces, name -> options of `make_force`: friction, controls, known physics.
        controls: number m of controls on which forces may depend.
    """

    def __init__(
        self,
        dof: int,
        *,
        inertia: float | list[float],
        hamiltonian: Structure,
        mu: float | None,
        falloff: float = 0.0,
        dimensions: int | None = None,
        inputs: InputName,
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        angular: list[bool] | None = None,
        forces: Mapping[str, Mapping[str, Any]] | None = None,
        controls: int = 0,
    ) -> None:
        options: dict[str, Any] = {"inputs": inputs, "scaling": scaling, "network": network}
        options |= {"angular": angular, "mu": mu, "falloff": falloff, "dimensions": dimensions}
        field: nn.Module = make_hamiltonian(hamiltonian, dof, mass=inertia, **options)
        near_others = hamiltonian == "central_body" and not falloff
        assumed = [f"{'perturbed_body' if near_others else hamiltonian} Hamiltonian, {inputs} inputs"]
        self.anchored = inputs in CENTRED or hamiltonian in CENTRED
        if forces:
            field = Forced(field, forces, dof, controls)
            self.anchored |= any(type(force).potential is not Force.potential for force in field.parts)
            self.clock = field.clock
            assumed += [force.assumes for force in field.parts]
        super().__init__(field, integrator)
        known = mu is not None or (isinstance(field, Forced) and bool(field.known))
        self.begins_known = known and hamiltonian in MOVES
        if self.begins_known:
            self.silence()
        self.assumes = ", ".join(assumed)

    @torch.no_grad()
    def silence(self) -> None:
        """Set the learned potential and learned forces to zero, so that only known physics remains."""
        field: nn.Module = self.field
        silence(field.hamiltonian if isinstance(field, Forced) else field)
        for force in field.parts if isinstance(field, Forced) else ():
            force.silence()

    def fused_layers(self, x: Tensor) -> Layers | None:
        """Return the layers of the field if steps from states like x are fused operations, else None."""
        field, method = self.field, self.integrator
        if not (isinstance(field, GenericHamiltonian) and isinstance(method, ExplicitRungeKutta)):
            return None
        return field.layers(x)

    def scheme(self, dt: TimeStep) -> Scheme:
        """Return method, step and activation of a fused operation."""
        field, method = cast(GenericHamiltonian, self.field), cast(ExplicitRungeKutta, self.integrator)
        return Scheme(method.tableau, column(dt), field.network.activation)

    def _as_one(self, x: Tensor, dt: TimeStep) -> tuple[Layers, Scheme] | None:
        """Return field and scheme if a step from states like x is a single fused operation, else None."""
        layers = self.fused_layers(x)
        return layers and (layers, self.scheme(dt))

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the integrator's increment along the field, shape (B, D)."""
        found = self._as_one(x, dt) if x.ndim == 2 else None
        return super().increment(x, dt) if found is None else fused_steps.step(x, *found)

    @torch.no_grad()
    def in_c(self) -> bool:
        """Return whether training steps are computed in C."""
        found = self._as_one(next(self.parameters()), 1.0)
        if found is None:
            return False
        layers, scheme = found
        return native.applies(scheme, layers.leave, layers.tensors)

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D), up to a constant.

        H includes the potentials of conservative forces, and is conserved if all forces are conservative.
        """
        return cast(Any, self.field).energy(x)
