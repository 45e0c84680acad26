"""Fit of a relative force error, its size and memory, to the residuals of a flow on validation trajectories.

The momentum residual of a step divided by its impulse is a direct observation of the error e of `ForceError`:
its correlation time gives the memory, its root mean square the size. As with Q in `process_noise`, the size
is then scaled until the mean NEES on validation arcs is D, since the error of a learned force is not exactly
a Gauss-Markov process and differs between orbits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.consistency import correlation_time
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.process_noise import crossing, mean_nees
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.trial import Filter
from ahnn.rollouts import clock_of, stepped
from ahnn.statistics import Statistics
from ahnn.types import Flow, Trajectories

SCALES = tuple(10.0**k for k in range(-1, 3))
"""Candidate factors on size²."""


class FittedForceError(NamedTuple):
    """Force error, factor on size² of the one-step residuals, and mean NEES of each candidate factor."""

    error: ForceError
    scale: float
    nees: tuple[float, ...]


def fitted_force_error(
    chosen: Filter,
    setting: Setting,
    problem: Problem,
    trajectories: Trajectories,
    inertia: float | Tensor,
    *,
    size: float | None = None,
    memory: float | None = None,
    growth: Callable[[Tensor], Tensor] | None = None,
) -> FittedForceError:
    """Fit the force error for which a filter is consistent on validation data.

    Args:
        chosen: filter whose force error is fitted.
        setting: measurement settings and P0.
        problem: V validation arcs for the choice of size.
        trajectories: trajectories with a common sampling interval, whose residuals give size and memory.
        inertia: the factor m in p = m dq/dt.
        size: prescribed size; None: the size of the residuals, scaled.
        memory: prescribed time constant; None: the time constant of the residuals.
        growth: function from states to factors on the error; None for 1 everywhere.
    """
    dt = float(Statistics.of(trajectories).dt)
    errors = force_errors(chosen.flow, trajectories, dt, growth)
    seen = float(errors[errors.isfinite()].square().mean().nan_to_num()) ** 0.5
    memory = memory_of(errors, dt) if memory is None else memory
    error = ForceError(seen if size is None else size, memory, inertia, growth)
    if size is not None or seen == 0.0:
        return FittedForceError(error, 1.0, ())
    values = mean_nees(chosen._replace(force_error=error), setting, problem, SCALES)
    scale = crossing(SCALES, values, float(problem.truth.shape[-1]))
    return FittedForceError(error._replace(size=scale**0.5 * seen), scale, tuple(values))


@torch.no_grad()
def force_errors(
    flow: Flow, trajectories: Trajectories, dt: float, growth: Callable[[Tensor], Tensor] | None = None
) -> Tensor:
    """Return the errors e (B, T - 1, n) of a flow per step, divided by growth; NaN where undefined."""
    before, after = trajectories.states[:, :-1], trajectories.states[:, 1:]
    dof = before.shape[-1] // 2
    clock = trajectories.clock(clock_of(flow))
    predicted = stepped(flow, before.flatten(0, 1), dt, clock and clock.of_steps())
    predicted = predicted.unflatten(0, before.shape[:2])
    impulse = (predicted - before)[..., dof:].norm(dim=-1, keepdim=True)
    errors = (after - predicted)[..., dof:] / impulse
    if growth is not None:
        errors = errors / growth(before).unsqueeze(-1)
    return torch.where(errors.isfinite(), errors, torch.nan)


def memory_of(errors: Tensor, dt: float) -> float:
    """Return the time constant of errors (B, T, n) from their correlation time; 0.1 dt if uncorrelated."""
    time = correlation_time(errors.movedim(-1, 1).flatten(0, 1))
    kept = 0.0 if time is None else (time - 1) / (time + 1)
    return dt / -math.log(min(max(kept, math.exp(-10.0)), 1 - 1e-12))
