"""Comparison of a system's energy with its equations of motion, by finite differences."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.systems.base import System

STATES = 20
"""Maximum number of states that are compared."""
REACH = 1e-5
"""Displacement of the differences, relative to the extent of the coordinates or momenta."""
ALLOWED = 1e-4
"""Tolerated difference, relative to the largest rate."""
ROUNDING = 16 * torch.finfo(torch.float64).eps
"""Bound of the rounding error of an energy, relative to it, which dominates for states at rest."""


def require_hamilton(system: System, states: Tensor) -> None:
    """Check that the Hamiltonian part of a system's field is that of its energy.

    Args:
        system: system with n degrees of freedom.
        states: (N, 2n) states, of which at most `STATES` are used.

    Raises:
        UserError: dq/dt or dp/dt differs from the derivatives of the energy.
    """
    x = states[:: -(-len(states) // STATES)]
    found = system.hamiltonian(x)
    of_q, of_p = energy_gradient(system, x).chunk(2, dim=-1)
    laws, least = ("dq/dt = dH/dp", "dp/dt = -dH/dq"), ROUNDING * system.energy(x).abs().max()
    blocks = zip(found.chunk(2, dim=-1), (of_p, -of_q), displacements(x).flip(0), laws, strict=True)
    for rates, expected, step, law in blocks:
        off = (rates - expected).abs().amax(-1)
        worst = int(off.argmax())
        largest = torch.maximum(rates.abs().max(), expected.abs().max())
        if bool(off[worst] > ALLOWED * largest + least / step):
            message = (
                f"system {system.name}: expected {law} of its energy; received {_listed(rates[worst])} at "
                f"state {_listed(x[worst])}, where the energy gives {_listed(expected[worst])}. Correct "
                "`energy`, or `force` and `velocity` (`hamiltonian`, if the system overrides it)"
            )
            raise UserError(message)


def energy_gradient(system: System, x: Tensor) -> Tensor:
    """Return dH/dx, shape (N, 2n), at states x, by central differences, which suit any energy."""
    steps = torch.diag(displacements(x).repeat_interleave(system.dof))
    around = x.unsqueeze(1)
    higher, lower = (system.energy((around + sign * steps).flatten(0, 1)) for sign in (1, -1))
    return (higher - lower).view(len(x), -1) / (2 * steps.diagonal())


def displacements(x: Tensor) -> Tensor:
    """Return the displacements of coordinates and of momenta, shape (2,), for states x, shape (N, 2n)."""
    extent = torch.stack([block.abs().max() for block in x.chunk(2, dim=-1)])
    return REACH * torch.where(extent > 0, extent, torch.ones_like(extent))


def _listed(values: Tensor) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in values.tolist()) + "]"
