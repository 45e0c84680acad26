"""Hamilton's equations with additional forces: friction, controls, forcing, known physics.

dq/dt = dH/dp, dp/dt = -dH/dq + sum of forces f(t, q, v, u) with v = dq/dt. With f = -R v + G u this is a
port-Hamiltonian system, whose energy changes by dH/dt = -v^T R v + v^T G u (van der Schaft & Jeltsema 2014).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, cast

import torch
from torch import Tensor, nn

from ahnn.clock import split
from ahnn.dynamics.forces import Force, Instant, make_force
from ahnn.errors import UserError
from ahnn.statistics import Statistics


def clock_size(forces: Iterable[Force], controls: int) -> int:
    """Return k, the number of clock coordinates of forces: 0, 1 for time, 1 + m for controls."""
    some = [*forces]
    if any(force.controlled for force in some):
        return 1 + controls
    return int(any(force.timed for force in some))


def total(forces: Iterable[Force], at: Instant) -> Tensor:
    """Return the sum of one or more forces, shape (..., n)."""
    return cast(Tensor, sum(force(at) for force in forces))


def forced(hamiltonian: Callable[[Tensor], Tensor], forces: Iterable[Force], z: Tensor, clock: int) -> Tensor:
    """Return dz/dt, shape (..., 2 (n + k)), of extended states z.

    Args:
        hamiltonian: x -> (dH/dp, -dH/dq), shape (..., 2n).
        forces: additional forces.
        z: extended states, shape (..., 2 (n + k)).
        clock: number k of clock coordinates.
    """
    q, c, p, rates = split(z, clock)
    v, pull = hamiltonian(torch.cat((q, p), dim=-1)).chunk(2, dim=-1)
    at = Instant(c[..., :1], c[..., 1:], q, v)
    return torch.cat((v, rates, pull + total(forces, at), torch.zeros_like(rates)), dim=-1)


class Forced(nn.Module):
    """Vector field of a learned Hamiltonian with forces, on extended states.

    Args:
        hamiltonian: field of H without forces.
        forces: name -> options of `make_force`.
        dof: degrees of freedom n.
        controls: number m of controls.
    """

    def __init__(
        self, hamiltonian: nn.Module, forces: Mapping[str, Mapping[str, Any]], dof: int, controls: int
    ) -> None:
        super().__init__()
        self.hamiltonian, self.dof = hamiltonian, dof
        made = {name: make_force(name, dof, controls, options) for name, options in forces.items()}
        self.forces = nn.ModuleDict(made)
        self.clock = clock_size(made.values(), controls)

    @property
    def parts(self) -> list[Force]:
        """The forces."""
        return [*cast("Iterable[Force]", self.forces.values())]

    @property
    def known(self) -> list[Force]:
        """Forces without learned parameters."""
        return [force for force in self.parts if not [*force.parameters()]]

    @property
    def forces_work(self) -> bool:
        """Whether any force has no potential, so that energy is not conserved."""
        q = torch.zeros(1, self.dof, dtype=torch.float64)
        at = Instant(q[:, :0], q[:, :0], q, q)
        return any(force.potential(at) is None for force in self.parts)

    def fit(self, statistics: Statistics) -> None:
        """Set all constants from the training split, from which known forces are subtracted."""
        left = statistics
        if self.known:
            at = Instant(
                statistics.clock[:, :1], statistics.clock[:, 1:], statistics.positions, statistics.velocities
            )
            left = statistics.without(total(self.known, at))
        for force in self.parts:
            force.fit(left)
        cast(Any, self.hamiltonian).fit(left)

    def seen(self, x: Tensor) -> Tensor:
        """Return the network inputs of H, (..., F), at the states x, shape (..., 2n)."""
        return cast(Any, self.hamiltonian).seen(x)

    def energy(self, x: Tensor) -> Tensor:
        """Return H plus the potentials of conservative forces, shape (...), at the states x, (..., 2n)."""
        q, nothing = x.chunk(2, dim=-1)[0], x[..., :0]
        value = cast(Any, self.hamiltonian).energy(x)
        at = Instant(nothing, nothing, q, torch.zeros_like(q))
        potentials = [force.potential(at) for force in self.parts]
        return cast(Tensor, sum((part for part in potentials if part is not None), value))

    def forward(self, z: Tensor) -> Tensor:
        """Return dz/dt, shape (..., 2 (n + k)), at extended states z.

        Raises:
            UserError: states without the clock coordinates on which forces depend.
        """
        if z.shape[-1] != 2 * (self.dof + self.clock):
            needed = "time and controls" if self.clock > 1 else "time"
            message = (
                f"dynamics: expected {needed} in addition to the states, since forces depend on it; received "
                "none. Pass start_time and controls to `run.rollout`"
            )
            raise UserError(message)
        return forced(self.hamiltonian, self.parts, z, self.clock)
