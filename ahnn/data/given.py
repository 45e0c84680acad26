"""Checks of trajectories that a user brings."""

from __future__ import annotations

import torch

from ahnn.errors import UserError
from ahnn.numbers import as_float64
from ahnn.types import Space, Trajectories


def check_trajectories(given: Trajectories, space: Space) -> Trajectories:
    """Return trajectories as float64 tensors, states (B, T, D) and times (B, T).

    Raises:
        UserError: shapes that do not fit the space, infinite numbers, or times that do not increase.
    """
    try:
        states, times = as_float64(given.states, "states"), as_float64(given.times, "times")
    except ValueError as error:
        raise UserError(str(error)) from error
    size = len(space.components)
    if size < 2 or size % 2:
        message = f"space: expected 2n components, positions first; received {size}: {space.components}"
        raise UserError(message)
    if states.ndim != 3 or states.shape[-1] != size or min(states.shape) < 1:
        message = (
            f"states: expected shape (trajectories, samples, {size}) of {', '.join(space.components)}; "
            f"received {tuple(states.shape)}"
        )
        raise UserError(message)
    if times.shape not in (states.shape[:2], states.shape[1:2]):
        message = (
            f"times: expected shape {tuple(states.shape[:2])}, or {tuple(states.shape[1:2])} for all alike; "
            f"received {tuple(times.shape)}"
        )
        raise UserError(message)
    if bool(states.isinf().any()) or bool(times.isinf().any()):
        message = "states and times: expected finite numbers, NaN where a sample is absent; received inf"
        raise UserError(message)
    trajectories = Trajectories(states, times.expand(states.shape[:2]))
    steps = trajectories.times.diff(dim=1)
    if bool((steps <= 0).any()):
        b, k = (int(n) for n in (steps <= 0).nonzero()[0])
        pair = trajectories.times[b, k : k + 2].tolist()
        message = f"times: expected increasing ones; received {pair} from sample {k} of trajectory {b}"
        raise UserError(message)
    unknown = trajectories.times.isnan()
    if bool((unknown[:, :-1] & ~unknown[:, 1:]).any()):
        message = "times: expected one for each sample, NaN only after the last; received NaN before another"
        raise UserError(message)
    if not bool((begins := trajectories.present[:, 0]).all()):
        b = int((~begins).nonzero()[0])
        message = f"states: expected the first sample of each trajectory; received NaN in that of {b}. Cut it"
        raise UserError(message)
    return trajectories._replace(states=torch.where(trajectories.present.unsqueeze(-1), states, torch.nan))
