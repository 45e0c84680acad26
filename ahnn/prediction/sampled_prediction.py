"""Predictions by sampled paths, for errors that are too large to propagate to first order."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.prediction.followed_path import Knowledge
from ahnn.progress import track
from ahnn.shooting.path_sensitivities import steps_between
from ahnn.uncertainty import drawn, sampled_paths


def path_samples(
    dynamics: Dynamics,
    start: Tensor,
    times: Tensor,
    longest: float,
    known: Knowledge,
    count: int,
    description: str | None = None,
    clock: Clock | None = None,
) -> Tensor:
    """Return sampled states at given times, (B, T, count, D).

    Args:
        dynamics: float64 dynamics.
        start: (B, D) states at the first of the times.
        times: (T,) increasing.
        longest: maximum integrator step.
        known: uncertainty information, at least on the starts or the parameters.
        count: number of paths from each start.
        description: text of the progress bar; None: no bar.
        clock: time and controls at the times; None for autonomous dynamics.
    """
    steps = steps_between(times.unsqueeze(0), longest)
    lengths, ends = steps.lengths[0], {int(end): k for k, end in enumerate(steps.ends)}
    along = None if clock is None else clock.along(lengths, steps.ends)
    draws = drawn(start, count, seed=0, own=known.start, common=None, spread=known.spread, matched=True)
    found = start.new_empty(len(start), len(times), count, start.shape[1], dtype=torch.float64)
    paths = enumerate(sampled_paths(dynamics, draws, lengths, known.domain, along))
    for step, x in track(paths, description, len(lengths) + 1) if description else paths:
        if (k := ends.get(step)) is not None:
            found[:, k] = x.transpose(0, 1)
    return found


def require_samples(count: int, numbers: int, known: Knowledge) -> None:
    """Raise UserError for paths that cannot be sampled: fewer than two, without uncertainty, or too many.

    Args:
        count: number of paths from each start.
        numbers: numbers of a path, over all starts and times.
        known: uncertainty information.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 2:
        message = f"samples: expected 2 paths or more; received {count!r}"
        raise UserError(message)
    if not known.columns:
        message = (
            "samples: expected a start or parameters with standard deviations; received exact ones. Add "
            "start_sd, or use a model trained on measurements"
        )
        raise UserError(message)
    require_memory("samples", "sampled states", 8.0 * count * numbers)
