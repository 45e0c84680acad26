"""Statistics of the training split: extremes, increments, rates and distances."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.types import TimeStep, Trajectories

CLOSE = 1e-9
"""Relative tolerance below which steps are equal: times are sums with rounding errors."""


class Statistics(NamedTuple):
    """Statistics of the training split; tensors are (D,) float64, in physical units, unless stated otherwise.

    Attributes:
        minimum, maximum: bounds of each state component.
        increment: root mean square of each component of x_{k+1} - x_k.
        rate: root mean square of each component of (x_{k+1} - x_k) / dt.
        radius: (2,) extremes of the distance |q| from the origin.
        positions, velocities, forces: (M, n) positions midway between a subset of the samples, with dq/dt
            and dp/dt.
        clock: (M, 1 + m) time and controls at these positions.
        dt: sampling interval; if steps differ, the median step of a subset of the trajectories.
        force_sd: (M, n) standard deviations of the forces, estimated from noisy samples; None for exact ones.
    """

    minimum: Tensor
    maximum: Tensor
    increment: Tensor
    rate: Tensor
    radius: Tensor
    positions: Tensor
    velocities: Tensor
    forces: Tensor
    clock: Tensor
    dt: float
    force_sd: Tensor | None = None

    def without(self, known: Tensor) -> Statistics:
        """Return the statistics after subtraction of forces `known`, (M, n), at the sample positions."""
        left = self.forces - known
        ratio = left.square().mean(0).sqrt() / self.forces.square().mean(0).sqrt()
        rate_q, rate_p = self.rate.chunk(2)
        return self._replace(forces=left, rate=torch.cat((rate_q, rate_p * ratio)))

    @classmethod
    def of(cls, trajectories: Trajectories, examples: int = 20_000) -> Statistics:
        """Compute the statistics of trajectories; missing samples and their adjacent steps are ignored."""
        trajectories = trajectories.each_timed()
        dt = sampling_interval(trajectories)
        uniform = isinstance(dt, float)
        spread = trajectories.spread()
        begins, increments, lengths = steps_of(spread)
        some = slice(None, None, max(1, len(begins) // examples))
        rates = increments[some] / (dt if uniform else lengths[some])
        extents = [Extent.of(part) for part in trajectories.parts()]
        count = sum(extent.steps for extent in extents)
        typical = (torch.stack([extent.increments for extent in extents]).sum(0) / count).sqrt()
        radius = torch.stack([extent.radius for extent in extents])
        return cls(
            minimum=torch.stack([extent.minimum for extent in extents]).amin(0),
            maximum=torch.stack([extent.maximum for extent in extents]).amax(0),
            increment=typical,
            rate=typical / dt if uniform else (torch.stack([e.rates for e in extents]).sum(0) / count).sqrt(),
            radius=torch.stack((radius[:, 0].min(), radius[:, 1].max())),
            positions=(begins + increments / 2)[some].chunk(2, dim=-1)[0],
            velocities=rates.chunk(2, dim=-1)[0],
            forces=rates.chunk(2, dim=-1)[1],
            clock=between(spread)[some],
            dt=dt if uniform else float(lengths.median()),
        )


class Extent(NamedTuple):
    """Contribution of a subset of the trajectories to the statistics of all.

    Attributes:
        minimum, maximum: (D,) extremes of each state component.
        radius: (2,) extremes of the distance from the origin.
        steps: number of steps between neighbouring samples.
        increments, rates: (D,) sums of squared increments and rates over these steps.
    """

    minimum: Tensor
    maximum: Tensor
    radius: Tensor
    steps: int
    increments: Tensor
    rates: Tensor

    @classmethod
    def of(cls, part: Trajectories) -> Extent:
        """Compute the extent of trajectories; this takes several times their memory."""
        flat = part.states[part.present]
        radius = flat.chunk(2, dim=-1)[0].norm(dim=-1)
        _, increments, lengths = steps_of(part)
        return cls(
            minimum=flat.amin(0),
            maximum=flat.amax(0),
            radius=torch.stack((radius.min(), radius.max())),
            steps=len(increments),
            increments=increments.square().sum(0),
            rates=(increments / lengths).square().sum(0),
        )


def between(trajectories: Trajectories) -> Tensor:
    """Return time and controls at the midpoints of the R steps of `steps_of`, (R, 1 + m)."""
    clock = Clock.of(trajectories.times, trajectories.controls, trajectories.linear).of_steps()
    there = increments_of(trajectories).isfinite().all(-1).flatten()
    half = trajectories.times.diff(dim=1).flatten()[there].unsqueeze(-1) / 2
    return clock.values[there] + half * clock.rates[there]


def steps_of(trajectories: Trajectories) -> tuple[Tensor, Tensor, Tensor]:
    """Return the initial states, increments and lengths of the R steps between neighbouring samples.

    Returns:
        Tensors (R, D), (R, D) and (R, 1).
    """
    steps = increments_of(trajectories)
    valid = steps.isfinite().all(-1)
    lengths = trajectories.times.diff(dim=1)[valid].unsqueeze(-1)
    return trajectories.states[:, :-1][valid], steps[valid], lengths


def increments_of(trajectories: Trajectories) -> Tensor:
    """Return x_{k+1} - x_k, shape (B, T - 1, D), NaN next to a missing sample."""
    states = trajectories.states
    return states[:, 1:] - states[:, :-1]


def sampling_interval(trajectories: Trajectories) -> TimeStep:
    """Return the common step between neighbouring samples, or all steps, (B, T - 1), if they differ."""
    times, count = trajectories.times, len(trajectories.times)
    if times.stride(0) == 0:  # all trajectories share the times
        times = times[:1]
    steps = times.diff(dim=1)
    known = steps[steps.isfinite()]
    if not len(known):
        return 0.0
    dt = float(known[0])
    # Times are sums of steps: their rounding error grows with time, not with the step.
    slack = CLOSE * abs(dt) + 4 * torch.finfo(times.dtype).eps * float(times[times.isfinite()].abs().max())
    return dt if float((known - dt).abs().max()) <= slack else steps.expand(count, -1)
