"""Generation of true trajectories in float64 by the exact flow of a system, part by part."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.progress import advancing
from ahnn.rollouts import stepped
from ahnn.systems import System
from ahnn.systems.drawn_states import drawn_states
from ahnn.systems.energy_check import require_conserved
from ahnn.systems.hamilton_check import require_hamilton
from ahnn.systems.truth import exact_flow
from ahnn.types import Trajectories, rows_of_part


def generate(system: System, count: int, seed: int) -> Trajectories:
    """Return all trajectories of `generated` in memory."""
    parts = [*generated(system, count, seed)]
    times = parts[0].times[:1].expand(count, -1)
    controls = [part.controls for part in parts if part.controls is not None]
    states = torch.cat([part.states for part in parts])
    return parts[0]._replace(states=states, times=times, controls=torch.cat(controls) if controls else None)


@torch.no_grad()
def generated(system: System, count: int, seed: int) -> Iterator[Trajectories]:
    """Yield `count` trajectories from initial states drawn with `seed`, in parts of limited size.

    All are padded with NaN to the length of the longest one. Each trajectory is independent of all other
    trajectories in its part.

    Raises:
        UserError: the trajectories are too long to be stored, become non-finite, or cannot be computed
            accurately, or the energy of the system is inconsistent with its force or not conserved.
    """
    generator = torch.Generator().manual_seed(seed)
    x = drawn_states(system, count, generator)
    steps = system.durations(x)
    longest = longest_of(system, steps)
    require_memory("system.steps, system.periods", "states of a trajectory", 8.0 * (longest + 1) * x.shape[1])
    times = torch.arange(longest + 1, dtype=torch.float64) * system.dt
    many = rows_of_part(longest + 1, x.shape[1])
    flow, controls = exact_flow(system), system.signal(times, count, generator)
    total = -(-count // many) * longest
    with advancing(f"generating {count} trajectories of {system.name}", total) as advance:
        for begin in range(0, count, many):
            now, ends = x[begin : begin + many], steps[begin : begin + many]
            own = None if controls is None else controls[begin : begin + many]
            part = Trajectories(now, times.expand(len(now), -1), own, system.linear)
            clock = part.clock(system.clock)
            states = torch.empty(len(now), longest + 1, now.shape[1], dtype=torch.float64)
            states[:, 0] = now
            for k in range(1, longest + 1):
                now = stepped(flow, now, system.dt, clock and clock.at(k - 1))
                states[:, k] = now
                advance()
            if begin == 0:
                require_hamilton(system, states[states.isfinite().all(-1)])
            require_finite(system, states, ends, begin)
            if int(ends.min()) < longest:
                states[torch.arange(longest + 1) > ends.unsqueeze(-1)] = torch.nan
            require_conserved(system, states, begin)
            yield part._replace(states=states)


def longest_of(system: System, steps: Tensor) -> int:
    """Return the longest of durations (B,); raises UserError for invalid durations."""
    if int(steps.min()) < 1:
        message = (
            f"system {system.name}: expected trajectories of at least one step; received zero or infinite "
            f"durations for {int((steps < 1).sum())} of {len(steps)}. Change its parameters"
        )
        raise UserError(message)
    return int(steps.max())


def require_finite(system: System, states: Tensor, ends: Tensor, before: int) -> None:
    """Check that trajectories (B, T, D), preceded by `before` more, are finite up to their ends (B,).

    Raises:
        UserError: a state is not finite, so that it can neither be learned nor scored.
    """
    if bool(states[torch.arange(len(states)), ends].isfinite().all()):
        return  # non-finite states stay non-finite
    wrong = ~states.isfinite().all(-1) & (torch.arange(states.shape[1]) <= ends.unsqueeze(-1))
    b, k = (int(n) for n in wrong.nonzero()[0])
    lost = f"{int(wrong.any(-1).sum())} of {len(states)} trajectories"
    message = (
        f"system {system.name}: expected finite states; received {states[b, k].tolist()} in trajectory "
        f"{before + b} after {k} steps of dt={system.dt}; {lost} diverge. Shorten system.dt or narrow the "
        "ranges of the initial states"
    )
    raise UserError(message)
