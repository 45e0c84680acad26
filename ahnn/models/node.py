"""NODE: a neural vector field with an integrator."""

from __future__ import annotations

from typing import Any, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.scaling import Kind
from ahnn.models.module import AbstractModel


@final
class NODE(AbstractModel):
    """Neural ordinary differential equation (Chen et al. 2018), differentiated through the integrator steps.

    Args:
        dof: degrees of freedom n.
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
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        options = {"scaling": scaling, "network": network, "integrator": integrator}
        super().__init__(make_dynamics("node", dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
