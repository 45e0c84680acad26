"""Symplectic one-step maps: SympNet, HénonNet and GHNN."""

from __future__ import annotations

from typing import Any, Literal, final

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.symplectic_map import Conformal
from ahnn.models.module import AbstractModel


@final
class SymplecticModel(AbstractModel):
    """Map from one sample to the next, symplectic by construction, with a fixed time step.

    Args:
        dof: degrees of freedom n.
        kind: kind of layers; see `ahnn.dynamics`.
        scaling: block or none, which preserve symplecticity.
        layers: number of layers.
        network: width, depth, activation.
        window: number W of recursive prediction steps in the loss.
        loss: options of `LossOptions`; a map has no field, so `derivative` must be 0.
        form: form of a SympNet, G or LA.
        shears: number of shears in a linear module of LA.
    """

    def __init__(
        self,
        dof: int,
        *,
        kind: Literal["sympnet", "henon_net", "generalised_hnn"],
        scaling: Conformal,
        layers: int,
        network: dict[str, Any],
        window: int,
        loss: dict[str, Any],
        form: Literal["G", "LA"] | None = None,
        shears: int | None = None,
    ) -> None:
        options: dict[str, Any] = {"scaling": scaling, "layers": layers, "network": network}
        given = {"form": form, "shears": shears}
        options |= {key: value for key, value in given.items() if value is not None}
        super().__init__(make_dynamics(kind, dof=dof, **options), dof, window, loss)
        self.save_hyperparameters()
