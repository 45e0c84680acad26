"""Generalised Hamiltonian neural networks, implemented from Horn et al. (2025, J. Comput. Phys. 521)."""

from __future__ import annotations

from typing import Any, final

from ahnn.dynamics.symplectic_map import Conformal, Layers, Shear, SymplecticMap


@final
class GeneralisedHNN(SymplecticMap):
    """Composition of symplectic Euler steps along separable Hamiltonians T_i(p) + V_i(q).

    Args:
        dof: degrees of freedom n.
        scaling: block or none.
        layers: number of Hamiltonians.
        network: width, depth, activation of each T_i and V_i.
    """

    assumes = "a symplectic map (GHNN)"
    anchored = False

    def __init__(self, dof: int, *, scaling: Conformal, layers: Layers, network: dict[str, Any]) -> None:
        shears = (Shear(dof, network, of_positions=k % 2 == 0) for k in range(2 * layers))
        super().__init__(dof, scaling, shears)
