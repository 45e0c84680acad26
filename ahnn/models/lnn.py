"""LNN: a learned Lagrangian with an integrator."""

from __future__ import annotations

from typing import Any, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.scaling import Kind
from ahnn.models.module import AbstractModel


@final
class LNN(AbstractModel):
    """Lagrangian neural network (Cranmer et al. 2020), on states [q, p] with p = m dq/dt.

    Args:
        dof: degrees of freedom n.
        inertia: factor m of p = m dq/dt, common or per coordinate.
        scaling: minmax, block or none.
        network: width, depth, activation.
        integrator: `name` and options of the one-step method.
        window: number W of recursive prediction steps in the loss.
        loss: options of `LossOptions`.
    """

    def __init__(
        self,
        dof: int,
        *,
        inertia: float | list[float],
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        options = {"inertia": inertia, "scaling": scaling, "network": network, "integrator": integrator}
        super().__init__(make_dynamics("lagrangian", dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
