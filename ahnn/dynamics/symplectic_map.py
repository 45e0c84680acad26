"""Symplectic one-step maps: compositions of shears, without a vector field.

A shear adds the gradient of a function of the positions to the momenta, or of the momenta to the positions;
compositions of shears are exactly symplectic for any functions. One scale for all positions and one for all
momenta preserves this in physical units.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import Annotated, Any, Literal, cast

import torch
from torch import Tensor, nn

from ahnn.arguments import Within
from ahnn.dynamics.networks import make_network
from ahnn.dynamics.step_map import StepMap
from ahnn.statistics import Statistics
from ahnn.types import TimeStep

Conformal = Literal["block", "none"]
"""Scalings that preserve symplecticity."""
Layers = Annotated[int, Within(1, 1000)]
"""Number of layers; larger numbers are most likely mistakes, and take minutes to build."""
Moves = tuple[Tensor, Tensor]
"""Increments of scaled positions and momenta by a layer, (B, n) each."""


class SymplecticLayer(nn.Module):
    """Near-identity symplectic map of scaled positions and momenta."""

    @abstractmethod
    def forward(self, q: Tensor, p: Tensor) -> Moves:
        """Return the increments of positions q and momenta p, (B, n) each."""


class Shear(SymplecticLayer):
    """Shear that adds the gradient of a network of the positions to the momenta, or vice versa.

    Args:
        dof: degrees of freedom n.
        network: width, depth, activation.
        of_positions: whether momenta are incremented by a function of positions.
    """

    def __init__(self, dof: int, network: dict[str, Any], *, of_positions: bool) -> None:
        super().__init__()
        self.network, self.of_positions = make_network(dof, 1, network), of_positions

    def forward(self, q: Tensor, p: Tensor) -> Moves:
        """Return the increments of positions q and momenta p, (B, n) each."""
        if self.of_positions:
            return torch.zeros_like(q), -self.network.gradient(q)
        return self.network.gradient(p), torch.zeros_like(p)


class SymplecticMap(StepMap):
    """Composition of layers from one sample to the next.

    Args:
        dof: degrees of freedom n.
        scaling: block or none.
        layers: the layers.
    """

    def __init__(self, dof: int, scaling: Conformal, layers: Iterable[SymplecticLayer]) -> None:
        super().__init__(dof, scaling)
        self.layers = nn.ModuleList(layers)

    def fit(self, statistics: Statistics) -> None:
        """Set the time step, one scale for all positions and one for all momenta from the training split."""
        super().fit(statistics)
        for block in (self.positions, self.momenta):
            block.affine.scale.fill_(block.affine.scale.max())

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the increment, shape (B, D), as a sum of layer increments, which avoids cancellation.

        Raises:
            UserError: dt is not the sampling interval of the training data.
        """
        self.require(dt)
        q, p = self.seen(x).chunk(2, dim=-1)
        moved_q, moved_p = torch.zeros_like(q), torch.zeros_like(p)
        for layer in cast("Iterable[SymplecticLayer]", self.layers):
            to_q, to_p = layer(q + moved_q, p + moved_p)
            moved_q, moved_p = moved_q + to_q, moved_p + to_p
        return torch.cat((self.positions.affine.scale * moved_q, self.momenta.affine.scale * moved_p), dim=-1)
