"""Process noise of a learned flow, fitted to its residuals on validation trajectories.

The shape of Q is the second moment of the one-step residuals r = F(x_k) - x_{k+1},

    Q1 = 1/N sum r rᵀ.

The filter adds Q at every step, assuming residuals that are independent in time. Residuals of a deterministic
model are correlated: over h steps in one direction the covariance of their sum grows to h² Q1, compared with
h Q1 for white noise, and a filter with Q1 is overconfident (trained models had mean NEES of 100 and more
instead of D). Hence

    Q = c Q1,

with c such that the filter's mean NEES on validation arcs is D. The NEES decreases with c; it is computed for
all candidates in one batch and interpolated on logarithmic scales.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.consistency import nees
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.trial import Filter, assimilate, shown
from ahnn.rollouts import clock_of, stepped
from ahnn.statistics import Statistics
from ahnn.types import Flow, Trajectories

SCALES = tuple(10.0**k for k in range(-1, 5))
"""Candidates for c; measured optima lie between 20 and 100."""

PAIRS = 20_000
"""Maximum number of pairs of successive states for which residuals are computed."""


class FittedNoise(NamedTuple):
    """Q = scale * one_step, with the mean NEES for each candidate scale, inf where members failed."""

    covariance: Tensor
    one_step: Tensor
    scale: float
    nees: tuple[float, ...]


@torch.no_grad()
def one_step_covariance(flow: Flow, trajectories: Trajectories) -> Tensor:
    """Return the second moment (D, D) of the one-step residuals of a flow.

    The mean is not subtracted, so that a constant error counts. Residuals that are not finite are omitted.
    """
    size = trajectories.states.shape[-1]
    before = trajectories.states[:, :-1].reshape(-1, size)
    after = trajectories.states[:, 1:].reshape(-1, size)
    chosen = torch.linspace(0, len(before) - 1, min(PAIRS, len(before)), dtype=torch.float64).long()
    clock, dt = trajectories.clock(clock_of(flow)), Statistics.of(trajectories).dt
    residual = stepped(flow, before[chosen], dt, clock and clock.of_steps().rows(chosen)) - after[chosen]
    residual = residual[residual.isfinite().all(-1)]
    return residual.mT @ residual / max(len(residual), 1)


def fitted_process_noise(
    chosen: Filter, setting: Setting, problem: Problem, trajectories: Trajectories
) -> FittedNoise:
    """Fit the process noise for which a filter is consistent on validation data.

    Args:
        chosen: filter to be tuned; its own Q is ignored.
        setting: measurement settings and P0.
        problem: V validation arcs for the choice of c.
        trajectories: validation trajectories, whose residuals give Q1.
    """
    one_step = one_step_covariance(chosen.flow, trajectories)
    if not bool((one_step.diagonal() > 0).any()):
        return FittedNoise(one_step, one_step, 1.0, ())
    values = mean_nees(chosen._replace(process_noise=one_step), setting, problem, SCALES)
    scale = crossing(SCALES, values, float(problem.truth.shape[-1]))
    return FittedNoise(scale * one_step, one_step, scale, tuple(values))


def mean_nees(chosen: Filter, setting: Setting, problem: Problem, scales: tuple[float, ...]) -> list[float]:
    """Return the mean NEES after the first update, for each factor of a filter's process noise.

    All factors are evaluated in one batch. A factor for which a member fails gives inf.

    Args:
        chosen: filter.
        setting: measurement settings and P0.
        problem: V validation arcs.
        scales: factors on the process noise.
    """
    batch, samples, _ = problem.truth.shape
    column = torch.tensor(scales, dtype=torch.float64).repeat_interleave(batch)
    with shown(chosen.flow, f"fitting Q of {chosen.name}", samples - 1) as flow:
        candidates = chosen._replace(flow=flow).scaled(column)
        result = assimilate(candidates, setting, problem.repeated(len(scales)))
    error = result.means - problem.truth[:, 1:].repeat(len(scales), 1, 1)
    settled = nees(error, result.chols)[:, setting.first - 1 :].nanmean(-1)
    settled = settled.masked_fill(result.status != 0, torch.inf)
    return settled.reshape(len(scales), batch).mean(-1).tolist()


def crossing(scales: tuple[float, ...], values: list[float], target: float) -> float:
    """Return the scale above which a falling series stays below a target, by log-log interpolation.

    Outside the range of scales the nearest one is returned.
    """
    above = [i for i, value in enumerate(values) if not value <= target]
    if not above:
        return scales[0]
    i = above[-1]
    if i == len(scales) - 1:
        return scales[-1]
    if not math.isfinite(values[i]):
        return scales[i + 1]
    low, high = math.log(values[i]), math.log(values[i + 1])
    fraction = (low - math.log(target)) / (low - high)
    return float(scales[i] * (scales[i + 1] / scales[i]) ** fraction)
