"""HénonNets, implemented from Burby, Tang & Maulik (2021, Plasma Phys. Control. Fusion 63, 024001)."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor, nn

from ahnn.dynamics.networks import make_network
from ahnn.dynamics.symplectic_map import Conformal, Layers, Moves, SymplecticLayer, SymplecticMap


class HenonLayer(SymplecticLayer):
    """Hénon map (q, p) -> (p + eta, -q + grad V(p)), applied four times; the identity for V = 0.

    Args:
        dof: degrees of freedom n.
        network: width, depth, activation of V.
    """

    def __init__(self, dof: int, network: dict[str, Any]) -> None:
        super().__init__()
        self.potential, self.shift = make_network(dof, 1, network), nn.Parameter(torch.zeros(dof))

    def forward(self, q: Tensor, p: Tensor) -> Moves:
        """Return the increments of positions q and momenta p, (B, n) each.

        The composition of four maps adds gradient differences: g_2 - g_0 to q and g_3 - g_1 to p.
        """
        gradients = []
        x, y = q, p
        for _ in range(4):
            gradients.append(self.potential.gradient(y))
            x, y = y + self.shift, gradients[-1] - x
        return gradients[2] - gradients[0], gradients[3] - gradients[1]


@final
class HenonNet(SymplecticMap):
    """HénonNet: a composition of Hénon layers.

    Args:
        dof: degrees of freedom n.
        scaling: block or none.
        layers: number of layers of four maps each.
        network: width, depth, activation of each potential.
    """

    assumes = "a symplectic map (HénonNet)"
    anchored = False

    def __init__(self, dof: int, *, scaling: Conformal, layers: Layers, network: dict[str, Any]) -> None:
        super().__init__(dof, scaling, (HenonLayer(dof, network) for _ in range(layers)))
