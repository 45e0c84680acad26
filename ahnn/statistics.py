"""What the training split says of sizes: extremes, increments, rates and distances."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.types import TimeStep, Trajectories

CLOSE = 1e-9
"""Steps that differ by less than this fraction are the same: times are sums, and round."""


class Statistics(NamedTuple):
    """Statistics of the training split; tensors are (D,) float64, in physical units, unless said otherwise.

    Attributes:
        minimum, maximum: of each state component.
        increment: root mean square of each component of x_{k+1} - x_k.
        rate: root mean square of each component of (x_{k+1} - x_k) / dt.
        radius: (2,) extremes of the distance |q| from the origin.
        positions, forces: (M, n) some positions half-way between samples, and dp/dt there.
        dt: sampling interval; the median of the steps where they differ.
    """

    minimum: Tensor
    maximum: Tensor
    increment: Tensor
    rate: Tensor
    radius: Tensor
    positions: Tensor
    forces: Tensor
    dt: float

    @classmethod
    def of(cls, trajectories: Trajectories, examples: int = 20_000) -> Statistics:
        """Return the statistics of trajectories; absent samples and the steps beside them do not count."""
        states, times = trajectories
        steps, dt = increments_of(trajectories), sampling_interval(trajectories)
        valid = steps.isfinite().all(-1)
        begins, increments = states[:, :-1][valid], steps[valid]
        lengths = dt if isinstance(dt, float) else times.diff(dim=1)[valid].unsqueeze(-1)
        flat = states[trajectories.present]
        every = max(1, len(begins) // examples)
        some = slice(None, None, every)
        rates = increments[some] / (lengths if isinstance(lengths, float) else lengths[some])
        radius = flat.chunk(2, dim=-1)[0].norm(dim=-1)
        typical = increments.square().mean(0).sqrt()
        uniform = isinstance(lengths, float)
        return cls(
            minimum=flat.amin(0),
            maximum=flat.amax(0),
            increment=typical,
            rate=typical / lengths if uniform else (increments / lengths).square().mean(0).sqrt(),
            radius=torch.stack((radius.min(), radius.max())),
            positions=(begins + increments / 2)[some].chunk(2, dim=-1)[0],
            forces=rates.chunk(2, dim=-1)[1],
            dt=lengths if uniform else float(lengths.median()),
        )


def increments_of(trajectories: Trajectories) -> Tensor:
    """Return x_{k+1} - x_k, shape (B, T - 1, D), NaN beside a sample that is absent."""
    states = trajectories.states
    return states[:, 1:] - states[:, :-1]


def sampling_interval(trajectories: Trajectories) -> TimeStep:
    """Return the one step between neighbouring samples, or all of them, (B, T - 1), where they differ."""
    times = trajectories.times
    steps = times.diff(dim=1)
    known = steps[steps.isfinite()]
    if not len(known):
        return 0.0
    dt = float(known[0])
    # Times are sums of steps: their rounding grows with the time and not with the step.
    slack = CLOSE * abs(dt) + 4 * torch.finfo(times.dtype).eps * float(times[times.isfinite()].abs().max())
    return dt if float((known - dt).abs().max()) <= slack else steps
