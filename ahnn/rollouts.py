"""Recursive prediction: a flow applied to its own output."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from ahnn.clock import Clock, extended, reduced
from ahnn.errors import UserError
from ahnn.progress import track
from ahnn.substeps import substeps
from ahnn.types import Flow, TimeStep

NEEDED = ("the times of the samples", "times and controls of the samples")
"""Dependencies of a flow for messages, by whether it has controls."""


def rollout(
    flow: Flow,
    start: Tensor,
    dt: TimeStep,
    samples: int,
    description: str | None = None,
    longest: float = math.inf,
    *,
    gradients: bool = False,
    clock: Clock | None = None,
) -> Tensor:
    """Return the trajectories of a flow, shape (B, samples, D), beginning with `start`, shape (B, D).

    Args:
        flow: map of a state over one step.
        start: (B, D) initial states.
        dt: time step, or (B, samples - 1) step lengths.
        samples: number of samples of the result, including the start.
        description: text of the progress bar; None: no bar.
        longest: maximum step of the flow; longer steps are divided into equal parts.
        gradients: whether to keep gradients through the result, at a cost in time and memory.
        clock: time and controls of the samples, (B, samples, k) or (samples, k), for a flow that depends on
            them.

    Raises:
        UserError: no clock is given for a flow that depends on time or controls.
    """
    count = clock_of(flow)
    if count and (clock is None or clock.values.shape[-1] < count):
        message = (
            f"rollout: expected {NEEDED[count > 1]}, on which the dynamics depend; received none. Give "
            f"{'`controls`' if count > 1 else '`times`'}"
        )
        raise UserError(message)
    own = clock.first(count) if count and clock is not None else None
    with torch.set_grad_enabled(gradients):
        states = _steps(flow, start, dt, samples, description, longest, own)
        if gradients:  # in-place writes would copy the entire gradient for each row in the backward pass
            return torch.stack(list(states), dim=1)
        out = start.new_empty(start.shape[0], samples, start.shape[1])
        for k, x in enumerate(states):
            out[:, k] = x
        return out


def _steps(
    flow: Flow,
    start: Tensor,
    dt: TimeStep,
    samples: int,
    description: str | None,
    longest: float,
    clock: Clock | None,
) -> Iterator[Tensor]:
    yield (x := start)
    steps = range(1, samples)
    for k in track(steps, description, len(steps)) if description else steps:
        step = dt[:, k - 1] if isinstance(dt, Tensor) else dt
        parts = substeps(step, longest) if longest < math.inf else 1
        x = stepped(flow, x, step, None if clock is None else clock.at(k - 1), parts)
        yield x


def stepped(flow: Flow, x: Tensor, dt: TimeStep, clock: Clock | None = None, parts: int = 1) -> Tensor:
    """Propagate states x, shape (B, 2n), over dt in equal parts; return (B, 2n).

    Args:
        flow: map of a state over one step.
        x: (B, 2n) states.
        dt: time step.
        clock: k clock coordinates at the beginning of the step, or None for an autonomous flow.
        parts: number of parts of the step.
    """
    z = x if clock is None else extended(x, clock)
    for _ in range(parts):
        z = flow(z, dt / parts)
    return z if clock is None else reduced(z, clock.values.shape[-1])


def clock_of(flow: Flow) -> int:
    """Return k, the number of clock coordinates of a flow; 0 for an autonomous flow."""
    return getattr(flow, "clock", 0)
