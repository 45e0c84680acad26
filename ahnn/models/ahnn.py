"""AHNN: a learned Hamiltonian with an integrator, trained on recursive predictions."""

from __future__ import annotations

from typing import Any, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.hamiltonians import Structure
from ahnn.dynamics.inputs import InputName
from ahnn.dynamics.scaling import Kind
from ahnn.models.module import AbstractModel


@final
class AHNN(AbstractModel):
    """Autoregressive Hamiltonian neural network of the paper; with one-step windows, its HNN⁺.

    All arguments but those of the loss are those of `ahnn.dynamics.HamiltonianDynamics`.

    Args:
        window: number W of recursive prediction steps in the loss.
        loss: options of `LossOptions`.
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
        window: int,
        loss: dict[str, Any],
        angular: list[bool] | None = None,
        forces: dict[str, dict[str, Any]] | None = None,
        controls: int = 0,
    ) -> None:
        options = {"inertia": inertia, "hamiltonian": hamiltonian, "mu": mu, "falloff": falloff}
        options |= {} if dimensions is None else {"dimensions": dimensions}
        options |= {"inputs": inputs, "scaling": scaling, "network": network, "integrator": integrator}
        if inputs == "angles":
            options |= {"angular": angular}
        if forces:  # weights of models without forces keep their original arguments
            options |= {"forces": forces, "controls": controls}
        super().__init__(make_dynamics("hamiltonian", dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
