"""Conversion of states, time steps and controls given by Python users to inputs of dynamics."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.data.files.table import LARGEST
from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.numbers import Numbers, as_count, as_float64, described
from ahnn.prediction.propagation import require_finite
from ahnn.types import Space, TimeStep


def states_of(x: Numbers, who: str, dynamics: Dynamics, space: Space) -> Tensor:
    """Return states (..., 2n) with the dtype and on the device of the parameters of the dynamics.

    Raises:
        UserError: the values are not states of the space; the message begins with `who`.
    """
    like = next(dynamics.parameters(), torch.empty(0, dtype=torch.float64))
    states, size = as_float64(x, who, like.device).to(like.dtype), len(space.components)
    if states.shape[-1:] != (size,):
        known, shape = ", ".join(space.components), tuple(states.shape)
        message = f"{who}: expected states [{known}] along the last axis; received shape {shape}"
        raise UserError(message)
    return states


def starts_of(start: Numbers, dynamics: Dynamics, space: Space) -> Tensor:
    """Return finite starts (B, 2n) from states (B, 2n) or (2n,); raises UserError otherwise."""
    x = torch.atleast_2d(states_of(start, "start", dynamics, space))
    if x.ndim > 2:
        message = f"start: expected shape (B, {x.shape[-1]}); received {tuple(x.shape)}"
        raise UserError(message)
    require_finite(x)
    return x


def paths_of(
    start: Numbers, steps: int, dt: Numbers, dynamics: Dynamics, space: Space
) -> tuple[Tensor, int, TimeStep]:
    """Return starts (B, 2n), the number of steps, and their common or individual lengths, (B, steps).

    Raises:
        UserError: invalid starts or steps, or insufficient memory.
    """
    x, count = starts_of(start, dynamics, space), as_count(steps, "steps")
    require_memory("steps", "predicted states", 8.0 * (count + 1) * x.numel())
    return x, count, lengths_of(dt, x.new_empty(len(x), count))


def clock_along(
    dynamics: Dynamics,
    lengths: TimeStep,
    count: int,
    start_time: float,
    controls: Numbers | None,
    starts: int,
) -> Clock | None:
    """Return the clock at the start of each of `count` steps; None for autonomous dynamics.

    Args:
        dynamics: dynamics, which define the clock coordinates.
        lengths: step lengths, common or (B, count).
        count: number of steps.
        start_time: time of the first step.
        controls: values during each step, (count, m) or (B, count, m); None without controls.
        starts: number B of starts.

    Raises:
        UserError: see `controls_of`.
    """
    size = max(0, dynamics.clock - 1)
    given = controls_of(controls, count, size, starts)
    if not dynamics.clock:
        return None
    steps = lengths if isinstance(lengths, Tensor) else torch.full((count,), lengths, dtype=torch.float64)
    times = start_time + steps.cumsum(-1) - steps
    if given is not None and given.ndim > times.ndim + 1:
        times = times.expand(given.shape[:-1])
    return Clock.of(times, None if given is None else given.expand(*times.shape, size))


def sample_clock(
    dynamics: Dynamics, times: Tensor, controls: Numbers | None, starts: int, *, linear: bool
) -> Clock | None:
    """Return the clock at times (T,) with controls (T, m) or (B, T, m); None for autonomous dynamics.

    Raises:
        UserError: see `controls_of`.
    """
    given = controls_of(controls, len(times), max(0, dynamics.clock - 1), starts)
    if not dynamics.clock:
        return None
    return Clock.of(times if given is None else times.expand(given.shape[:-1]), given, linear)


def controls_of(controls: Numbers | None, count: int, size: int, starts: int) -> Tensor | None:
    """Return m = `size` controls at `count` instants, (count, m) or (B, count, m); None for m = 0.

    Raises:
        UserError: the controls are missing, of the wrong shape, too large, or not used by the dynamics.
    """
    given = None if controls is None else as_float64(controls, "controls")
    shapes = ((count, size), (starts, count, size))
    if (given is None) != (size == 0) or (given is not None and tuple(given.shape) not in shapes):
        shape = f"shape ({count}, {size}), or one such array per start"
        expected = shape if size else "None, since no force depends on controls"
        received = "None" if given is None else f"shape {tuple(given.shape)}"
        message = f"controls: expected {expected}; received {received}"
        raise UserError(message)
    if given is not None and not bool((given.abs() <= LARGEST).all()):
        message = f"controls: expected finite numbers up to {LARGEST:g}; received larger or non-finite ones"
        raise UserError(message)
    return given


def lengths_of(dt: Numbers, like: Tensor) -> TimeStep:
    """Return a finite time step, or a tensor of such steps; raises UserError otherwise."""
    step = as_float64(dt, "dt", like.device)
    if step.shape not in ((), like.shape) or not bool(step.isfinite().all()):
        received = float(step) if step.ndim == 0 else described(step)
        message = f"dt: expected one finite number, or shape {tuple(like.shape)}; received {received}"
        raise UserError(message)
    return step.expand(like.shape) if step.ndim or step.requires_grad else float(step)
