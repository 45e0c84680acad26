"""The training of these dynamics: a LightningModule whose arguments are the keys of `model` in YAML."""

from typing import Any, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.scaling import Kind
from ahnn.models import AbstractModel


@final
class NewtonModel(AbstractModel):
    """Which dynamics are trained; `dof`, `inertia` and `window` come from the data and the command."""

    def __init__(
        self,
        dof: int,
        *,
        inertia: float,
        scaling: Kind,
        network: dict[str, Any],
        integrator: dict[str, Any],
        window: int,
        loss: dict[str, Any],
    ) -> None:
        options = {"inertia": inertia, "scaling": scaling, "network": network, "integrator": integrator}
        super().__init__(make_dynamics("newton", dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
