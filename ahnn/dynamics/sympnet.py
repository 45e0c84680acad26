"""SympNets, implemented from Jin, Zhang, Zhu, Tang & Karniadakis (2020, Neural Networks 132, 166)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, final

import torch
from torch import Tensor, nn

from ahnn.dynamics.activations import ACTIVATIONS, ActivationName
from ahnn.dynamics.symplectic_map import Conformal, Layers, Moves, Shear, SymplecticLayer, SymplecticMap
from ahnn.errors import UserError


class LinearLayer(SymplecticLayer):
    """Alternating shears by symmetric matrices, and a shift; enough shears give any linear symplectic map.

    Args:
        dof: degrees of freedom n.
        shears: number of shears.
        of_positions: whether the first shear changes momenta.
    """

    def __init__(self, dof: int, shears: int, *, of_positions: bool) -> None:
        super().__init__()
        self.halves = nn.Parameter(0.01 * torch.randn(shears, dof, dof))
        self.shift = nn.Parameter(torch.zeros(2, dof))
        self.of_positions = of_positions

    def forward(self, q: Tensor, p: Tensor) -> Moves:
        """Return the increments of positions q and momenta p, (B, n) each."""
        moved_q, moved_p = torch.zeros_like(q), torch.zeros_like(p)
        for k, half in enumerate(self.halves):
            if (k % 2 == 0) == self.of_positions:
                moved_p = moved_p + (q + moved_q) @ (half + half.T)
            else:
                moved_q = moved_q + (p + moved_p) @ (half + half.T)
        return moved_q + self.shift[0], moved_p + self.shift[1]


class ActivationLayer(SymplecticLayer):
    """Function of each position added to its momentum, or vice versa.

    Args:
        dof: degrees of freedom n.
        activation: name of the function.
        of_positions: whether momenta are changed.
    """

    def __init__(self, dof: int, activation: ActivationName, *, of_positions: bool) -> None:
        super().__init__()
        self.factors = nn.Parameter(0.01 * torch.randn(dof))
        self.activation, self.of_positions = ACTIVATIONS[activation], of_positions

    def forward(self, q: Tensor, p: Tensor) -> Moves:
        """Return the increments of positions q and momenta p, (B, n) each."""
        if self.of_positions:
            return torch.zeros_like(q), self.factors * self.activation.value(q)
        return self.factors * self.activation.value(p), torch.zeros_like(p)


@final
class SympNet(SymplecticMap):
    """SympNet of gradient modules (G), or of linear and activation modules (LA).

    Args:
        dof: degrees of freedom n.
        scaling: block or none.
        form: `G` or `LA`.
        layers: number of modules of each kind that change positions, and as many that change momenta.
        shears: number of shears in a linear module of LA; None for 4.
        network: activation, and width of the gradient modules of G; `depth` is ignored.
    """

    assumes = "a symplectic map (SympNet)"
    anchored = False

    def __init__(
        self,
        dof: int,
        *,
        scaling: Conformal,
        form: Literal["G", "LA"],
        layers: Layers,
        shears: Layers | None = None,
        network: dict[str, Any],
    ) -> None:
        if form == "G" and shears is not None:
            message = (
                f"model.shears: expected none with form=G, which has no linear modules; received {shears}"
            )
            raise UserError(message)
        several = 4 if shears is None else shears

        def made() -> Iterator[SymplecticLayer]:
            for k in range(2 * layers):
                of_positions = k % 2 == 0
                if form == "G":
                    yield Shear(dof, {**network, "depth": 1}, of_positions=of_positions)
                    continue
                yield LinearLayer(dof, several, of_positions=of_positions)
                yield ActivationLayer(dof, network.get("activation", "gelu"), of_positions=of_positions)
            if form == "LA":
                yield LinearLayer(dof, several, of_positions=True)

        super().__init__(dof, scaling, made())
