"""MLP: a network that maps one state to the next."""

from __future__ import annotations

from typing import Any, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.scaling import Kind
from ahnn.models.module import AbstractModel


@final
class MLP(AbstractModel):
    """The paper's first baseline: a map with a fixed time step, without field or integrator.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        residual: whether to learn the increment instead of the next state.
        network: width, depth, activation.
        window: number W of recursive prediction steps in the loss.
        loss: options of `LossOptions`; a map has no field, so `derivative` must be 0.
    """

    def __init__(
        self,
        dof: int,
        *,
        scaling: Kind,
        residual: bool,
        network: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        options = {"scaling": scaling, "residual": residual, "network": network}
        super().__init__(make_dynamics("map", dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
