"""Exact flow of a system, with step sizes chosen by accuracy."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS
from ahnn.jacobians import differenced
from ahnn.rollouts import rollout
from ahnn.substeps import substeps, substeps_of_each
from ahnn.systems.base import System
from ahnn.systems.drawn_states import drawn_states
from ahnn.systems.encounters import through_encounters
from ahnn.types import Flow, TimeStep

ACCURACY = 1e-10
"""Tolerated error of a full trajectory, relative to the size of positions and of momenta."""
TRIED, STEPS = 16, 24
"""Number of trajectories and sampling intervals in a trial."""
FINEST = 64
"""Maximum number of substeps of a sampling interval."""
DIFFERENCE = 1e-3
"""Half-width of central differences of a flow, relative to the system's default initial deviations."""
_KNOWN: dict[str, int] = {}
"""Numbers of substeps by the `repr` of a system, since its parameters may be unhashable."""


def exact_flow(system: System) -> Flow:
    """Return the flow of a system with its own integrator and as many substeps as accuracy requires.

    Raises:
        UserError: no admissible number of substeps is accurate.
    """
    count = accurate_substeps(system)
    return system.compiled(SubstepsFlow(system, count, system.singular), system.dt / count)


def varied_flow(system: System, constants: Mapping[str, Tensor]) -> Flow:
    """Return the exact flow of a system with constants that differ between states.

    Args:
        system: system whose number of substeps is used for all.
        constants: constants by name, (B, 1) each for states (B, D).

    Raises:
        UserError: no admissible number of substeps is accurate.
    """
    varied = copy.copy(system)
    for name, values in constants.items():
        object.__setattr__(varied, name, values)  # bypasses the checks of single numbers
    vars(varied).pop("forces", None)  # computed from the previous constants
    return SubstepsFlow(varied, accurate_substeps(system))


def accurate_substeps(system: System) -> int:
    """Return the number of substeps per sampling interval.

    The error of a trial with n substeps is its difference from one with 2n, extrapolated in proportion to
    time to the length of a trajectory.

    Raises:
        UserError: the finest step does not reach `ACCURACY`, so the truth is unusable for scores.
    """
    if (key := repr((type(system), system))) in _KNOWN:
        return _KNOWN[key]
    count, error = 1, math.inf
    while count <= FINEST:
        error = _trial_error(system, count)
        if error <= ACCURACY:
            _KNOWN[key] = count
            return count
        count *= 2
    message = (
        f"system {system.name}: expected reference states with a relative accuracy of {ACCURACY:g}; "
        f"received dt={system.dt:g}, for which {FINEST} substeps of {system.integrator} have an error of "
        f"{error:.1e}. Shorten system.dt"
    )
    raise UserError(message)


@torch.no_grad()
def _trial_error(system: System, count: int) -> float:
    """Return the estimated error of a trajectory with `count` substeps, relative to its size."""
    generator = torch.Generator().manual_seed(0)
    start = drawn_states(system, TRIED, generator)
    whole = int(system.durations(start).max())
    steps = min(whole, max(4, STEPS // count))
    times = torch.arange(steps + 1, dtype=torch.float64) * system.dt
    clock = Clock.of(times.expand(TRIED, -1), system.signal(times, TRIED, generator), system.linear)
    flows = [system.compiled(SubstepsFlow(system, n), system.dt / n) for n in (count, 2 * count)]
    coarse, fine = (rollout(flow, start, system.dt, steps + 1, clock=clock) for flow in flows)
    x, y, size = coarse[:, -1], fine[:, -1], fine.abs().amax(1)
    blocks = zip((x - y).chunk(2, dim=-1), size.chunk(2, dim=-1), strict=True)
    errors = [
        float(difference.norm(dim=-1).max() / extent.norm(dim=-1).max()) for difference, extent in blocks
    ]
    worst = max(errors) * whole / steps
    return worst if math.isfinite(worst) else 0.0  # generation reports the divergence


class SubstepsFlow(NamedTuple):
    """Flow of a system with `number` substeps per sampling interval, and in proportion for other steps.

    If `guarded`, steps that do not conserve the energy are halved.
    """

    system: System
    number: int
    guarded: bool = False

    @property
    def clock(self) -> int:
        """Number of clock coordinates of its states."""
        return self.system.clock

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt."""
        integrator, longest = INTEGRATORS[self.system.integrator], self.system.dt / self.number
        if isinstance(dt, Tensor) and dt.ndim:
            parts = substeps_of_each(dt.abs().nan_to_num(), longest)
            y = self._of_members(x, dt, parts)
        else:
            parts, y = substeps(dt, longest), x
            for _ in range(parts):
                y = integrator.step(self.system, y, dt / parts)
        if not self.guarded:
            return y
        before, after = (one.reshape(-1, x.shape[-1]) for one in (x, y))
        steps = torch.as_tensor(dt, dtype=x.dtype).expand(x.shape[:-1]).flatten()
        counts = torch.as_tensor(parts).expand(x.shape[:-1]).flatten()
        found = through_encounters(self.system, self._of_members, before, after, steps, counts)
        return found.reshape(x.shape)

    def _of_members(self, x: Tensor, dt: Tensor, parts: Tensor) -> Tensor:
        """Propagate states (B, D) over steps (B,) with individual numbers of parts (B,)."""
        integrator, length = INTEGRATORS[self.system.integrator], dt / parts
        for k in range(int(parts.max())):
            x = torch.where((parts > k).unsqueeze(-1), integrator.step(self.system, x, length), x)
        return x

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after dt, and the state transitions (B, D, D)."""
        return differenced(self, x, dt, self.half)

    @property
    def half(self) -> Tensor:
        """Half-widths of differences, (2 (n + k),); for the clock, fractions of an interval."""
        position, momentum = (DIFFERENCE * self.system.deviations()).chunk(2)
        rates = position.new_full((self.clock,), DIFFERENCE)
        return torch.cat((position, self.system.dt * rates, momentum, rates))
