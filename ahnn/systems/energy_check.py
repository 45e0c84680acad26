"""Check that generated trajectories conserve the energy of their system."""

from __future__ import annotations

import logging

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.systems.base import System
from ahnn.systems.encounters import ROUNDING, energy_size

log = logging.getLogger(__name__)
INACCURATE, WRONG = 1e-6, 1e-2
"""Changes of the energy, relative to p dq/dt and q dp/dt, that are reported and refused."""
ROWS = 64
"""Number of trajectories that are checked at a time."""


def require_conserved(system: System, states: Tensor, before: int) -> None:
    """Check that trajectories (B, T, D), preceded by `before` more, conserve the energy of a free system.

    Close encounters may exceed the resolution of numbers; inaccurate trajectories are reported.

    Raises:
        UserError: the energy of a trajectory is wrong, and so are its states.
    """
    if system.forces:
        return
    lost = torch.cat([energy_change(system, part) for part in states.split(ROWS)])
    worst, count = int(lost.argmax()), int((lost > INACCURATE).sum())
    most = float(lost[worst])
    said = f"{count} of {len(states)} trajectories change their energy, by up to {100 * most:.1g} %"
    if most > WRONG:
        message = (
            f"system {system.name}: expected reference states that conserve the energy; received trajectory "
            f"{before + worst}, among others: {said}. Shorten system.dt, narrow the ranges of the initial "
            "states, or set `singular` in its class"
        )
        raise UserError(message)
    if count:
        message = "system %s: %s (trajectory %d): close encounters are inaccurate"
        log.warning(message, system.name, said, before + worst)


def energy_change(system: System, states: Tensor) -> Tensor:
    """Return the largest change of energy of trajectories (B, T, D), relative to p dq/dt and q dp/dt, (B,).

    States that are not finite are left out.
    """
    known = states.isfinite().all(-1)
    energy = system.energy(states)
    change = (energy - energy[:, :1]).abs() - ROUNDING * energy.abs()
    size, _ = energy_size(system, states)
    return change.where(known, 0.0).amax(1) / size.where(known, 0.0).amax(1)
