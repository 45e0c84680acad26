"""Ground truth: all trajectories of a system at once, in float64, by its own integrator."""

from __future__ import annotations

import torch

from ahnn.integrators import INTEGRATORS
from ahnn.progress import track
from ahnn.systems import System
from ahnn.types import Trajectories


@torch.no_grad()
def generate(system: System, count: int, seed: int) -> Trajectories:
    """Return `count` trajectories from initial states drawn with `seed`.

    All are integrated together for as long as the longest one; what lies beyond the end of a shorter one
    is NaN.
    """
    integrator = INTEGRATORS[system.integrator]
    x = system.initial_states(count, torch.Generator().manual_seed(seed))
    steps = system.durations(x)
    longest = int(steps.max())
    states = torch.empty(count, longest + 1, x.shape[-1], dtype=torch.float64)
    states[:, 0] = x
    for k in track(range(1, longest + 1), f"generating {count} trajectories of {system.name}", longest):
        x = integrator.step(system, x, system.dt)
        states[:, k] = x
    beyond = torch.arange(longest + 1) > steps.unsqueeze(-1)
    states[beyond] = torch.nan
    return Trajectories(states, steps + 1, system.dt)
