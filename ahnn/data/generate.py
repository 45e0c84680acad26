"""Ground truth: all trajectories of a system at once, in float64, by its exact flow."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.progress import track
from ahnn.systems import System
from ahnn.systems.truth import exact_flow
from ahnn.types import Trajectories


@torch.no_grad()
def generate(system: System, count: int, seed: int) -> Trajectories:
    """Return `count` trajectories from initial states drawn with `seed`.

    All are integrated together for as long as the longest one; the states beyond the end of a shorter one
    are NaN.

    Raises:
        UserError: the trajectories are too long to be kept, do not stay finite, or cannot be made accurate.
    """
    x = system.initial_states(count, torch.Generator().manual_seed(seed))
    steps = system.durations(x)
    longest = int(steps.max())
    states = room(system, x, steps)
    states[:, 0] = x
    flow = exact_flow(system)
    for k in track(range(1, longest + 1), f"generating {count} trajectories of {system.name}", longest):
        x = flow(x, system.dt)
        states[:, k] = x
    beyond = torch.arange(longest + 1) > steps.unsqueeze(-1)
    require_finite(system, states, beyond)
    states[beyond] = torch.nan
    times = torch.arange(longest + 1, dtype=torch.float64) * system.dt
    return Trajectories(states, times.expand(count, -1))


def room(system: System, x: Tensor, steps: Tensor) -> Tensor:
    """Return an empty tensor (B, T, D) for trajectories of these steps (B,) from the states x, shape (B, D).

    Raises:
        UserError: a duration that is none, or more than the memory holds.
    """
    count, size = x.shape
    if int(steps.min()) < 1:
        received = f"received durations that are zero or infinite, {int((steps < 1).sum())} of {count}"
    else:
        try:
            return torch.empty(count, int(steps.max()) + 1, size, dtype=torch.float64)
        except RuntimeError:
            received = f"received {count} of up to {int(steps.max()):,} steps"
    message = f"system {system.name}: expected trajectories that fit into memory; {received}. Shorten them"
    raise UserError(message)


def require_finite(system: System, states: Tensor, beyond: Tensor) -> None:
    """Check trajectories (B, T, D) wherever they are not `beyond` their end, (B, T).

    Raises:
        UserError: a state is not finite; nothing could be learned from it, nor scored.
    """
    wrong = ~(states.isfinite().all(-1) | beyond)
    if not bool(wrong.any()):
        return
    b, k = (int(n) for n in wrong.nonzero()[0])
    lost = f"{int(wrong.any(-1).sum())} of {len(states)} trajectories"
    message = (
        f"system {system.name}: expected finite states; {lost} diverge, number {b} after {k} steps "
        f"of dt={system.dt}: received {states[b, k].tolist()}. "
        "Shorten system.dt or narrow the ranges of the initial states"
    )
    raise UserError(message)
