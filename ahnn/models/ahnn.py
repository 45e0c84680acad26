"""AHNN: a learned Hamiltonian through an integrator, trained on its own recursive predictions."""

from __future__ import annotations

from typing import Any, final

from torch import Tensor

from ahnn.dynamics.hamiltonians import Structure, make_hamiltonian
from ahnn.dynamics.inputs import InputName
from ahnn.dynamics.scaling import Kind
from ahnn.integrators import make_integrator
from ahnn.models.base import AbstractDynamics
from ahnn.types import TimeStep


@final
class AHNN(AbstractDynamics):
    """Autoregressive Hamiltonian neural network (the paper); over windows of one step it is its HNN⁺.

    Args:
        dof: degrees of freedom n.
        inertia: factor m of T = p^2 / 2m, used by `mechanical` and `central_body`.
        hamiltonian: generic, separable, mechanical or central_body.
        mu: gravitational parameter of `central_body`; None learns it.
        inputs: cartesian or isotropic positions.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.
        window: W, steps of the recursive predictions in the loss.
        loss: options of `Loss`.
    """

    def __init__(
        self,
        dof: int,
        *,
        inertia: float,
        hamiltonian: Structure,
        mu: float | None,
        inputs: InputName,
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        learner = make_hamiltonian(
            hamiltonian, dof, mass=inertia, mu=mu, inputs=inputs, scaling=scaling, network=network
        )
        super().__init__(learner, dof, window, loss)
        self.save_hyperparameters()
        self.integrator = make_integrator(**integrator)
        self.integrator.require(self.learner)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the integrator's increment along J grad H, shape (B, D)."""
        return self.integrator.increment(self.learner, x, dt)
