"""Initial states of a system, after a check of the tensors that its methods return."""

from __future__ import annotations

from typing import Any

import torch
from torch import Generator, Tensor

from ahnn.errors import UserError
from ahnn.numbers import described
from ahnn.systems.base import System

TRIED = 3
"""Number of states at which the methods are tried, which differs from the sizes of small states."""


@torch.no_grad()
def drawn_states(system: System, count: int, generator: Generator) -> Tensor:
    """Return the initial states of `count` trajectories, shape (count, 2n), float64.

    Raises:
        UserError: the states, or the energy, velocity, force or field at them, have another shape or dtype
            than `System` states.
    """
    x: Any = system.initial_states(count, generator)
    require_tensor(system, "initial_states", x, (count, 2 * system.dof), "count, 2n")
    some = x[:1].expand(TRIED, -1).clone()
    q, p = some.chunk(2, dim=-1)
    require_tensor(system, "energy", system.energy(some), (TRIED,), "N")
    if type(system).hamiltonian is System.hamiltonian:
        require_tensor(system, "velocity", system.velocity(p), tuple(p.shape), "N, n")
        require_tensor(system, "force", system.force(q), tuple(q.shape), "N, n")
    require_tensor(system, "hamiltonian", system.hamiltonian(some), tuple(some.shape), "N, 2n")
    return x


def require_tensor(system: System, method: str, value: Any, shape: tuple[int, ...], names: str) -> None:
    """Raise UserError unless a method of a system returned a float64 tensor of a shape."""
    if not isinstance(value, Tensor) or value.shape != shape:
        which = f"shape {shape}, that is ({names}{',' if len(shape) == 1 else ''})"
        message = (
            f"system {system.name}: expected a tensor of {which} from `{method}`; received "
            f"{described(value)}. Keep all axes of the states, as in q[..., :1]; q[..., 0] removes one"
        )
        raise UserError(message)
    if value.dtype != torch.float64:
        message = (
            f"system {system.name}: expected float64 numbers from `{method}`; received "
            f"{str(value.dtype).removeprefix('torch.')}. Give dtype=torch.float64 where tensors are made"
        )
        raise UserError(message)
