"""Steps through close encounters of bodies, halved until they conserve the energy.

The substeps of a system suit its usual motion. In an encounter at a distance r the force changes within
a time proportional to r^1.5, so that a step may miss it, and the bodies gain any amount of energy.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ahnn.systems.base import System

DRIFT = 1e-12
"""Tolerated change of the energy in a step, relative to p dq/dt and q dp/dt at its ends."""
ROUNDING = 64 * torch.finfo(torch.float64).eps
"""Bound of the rounding error of an energy, relative to the sum of the sizes of its terms."""
HALVINGS = 24
"""Maximum number of times that a step is halved."""

Step = Callable[[Tensor, Tensor, Tensor], Tensor]
"""States (B, D), steps (B,) and their numbers of parts (B,) -> states (B, D) after the steps."""


def through_encounters(
    system: System, step: Step, x: Tensor, y: Tensor, dt: Tensor, parts: Tensor, halvings: int = HALVINGS
) -> Tensor:
    """Replace the states y after steps that do not conserve the energy by those after halved steps.

    Args:
        system: system without forces beside its Hamiltonian.
        step: integration with a number of parts per step.
        x: states (B, D) before the steps.
        y: states (B, D) after them.
        dt: steps, (B,).
        parts: numbers of parts, (B,).
        halvings: number of times that a step may be halved.
    """
    lost = x.isfinite().all(-1) & ~conserved(system, x, y)
    if halvings == 0 or not bool(lost.any()):
        return y
    own, half, count = x[lost], dt[lost] / 2, parts[lost]
    for _ in range(2):
        after = step(own, half, count)
        own = through_encounters(system, step, own, after, half, count, halvings - 1)
    return y.index_put((lost,), own)


def conserved(system: System, x: Tensor, y: Tensor) -> Tensor:
    """Return whether states x and y (..., D) have the same energy, (...) bool; False if it is not finite."""
    allowed = sum(_tolerance(system, one) for one in (x, y))
    return (system.energy(y) - system.energy(x)).abs() <= allowed


def _tolerance(system: System, x: Tensor) -> Tensor:
    """Return the tolerated error of the energy at states (..., D), shape (...)."""
    size, terms = energy_size(system, x)
    return DRIFT * size + ROUNDING * terms


def energy_size(system: System, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return |p dq/dt| + |q dp/dt| at states (..., D), and the sum of the sizes of its terms, each (...)."""
    products = (x * system.hamiltonian(x).roll(x.shape[-1] // 2, -1)).unflatten(-1, (2, -1))
    return products.sum(-1).abs().sum(-1), products.abs().sum((-2, -1))
