"""Recursive prediction: a flow applied to its own output."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.progress import track
from ahnn.substeps import substeps
from ahnn.types import Flow, TimeStep


def rollout(
    flow: Flow,
    start: Tensor,
    dt: TimeStep,
    samples: int,
    description: str | None = None,
    longest: float = math.inf,
    *,
    gradients: bool = False,
) -> Tensor:
    """Return the trajectories of a flow, shape (B, samples, D), beginning with `start`, shape (B, D).

    Args:
        flow: map of a state over one step.
        start: states at time zero.
        dt: time step, or (B, samples - 1) with the length of each.
        samples: length of the result, start included.
        description: text of a progress bar; None shows none.
        longest: step of the flow; longer ones are cut into equal parts.
        gradients: whether they flow through the result, at the cost of the time and memory that they take.
    """
    with torch.set_grad_enabled(gradients):
        return _rolled(flow, start, dt, samples, description, longest)


def _rolled(
    flow: Flow, start: Tensor, dt: TimeStep, samples: int, description: str | None, longest: float
) -> Tensor:
    out = start.new_empty(start.shape[0], samples, start.shape[1])
    out[:, 0] = x = start
    steps = range(1, samples)
    for k in track(steps, description, len(steps)) if description else steps:
        step = dt[:, k - 1] if isinstance(dt, Tensor) else dt
        parts = substeps(step, longest) if longest < math.inf else 1
        for _ in range(parts):
            x = flow(x, step / parts)
        out[:, k] = x
    return out
