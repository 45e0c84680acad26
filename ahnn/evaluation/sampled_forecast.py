"""Errors of forecasts in standard deviations of sampled paths, where first-order bands mean little."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.evaluation.forecast_variances import Variances
from ahnn.shooting.path_sensitivities import Steps
from ahnn.uncertainty import drawn, mixture_moments, sampled_paths


def sampled_errors(
    dynamics: Dynamics,
    states: Tensor,
    steps: Steps,
    variances: Variances,
    spread: Tensor,
    true: Tensor,
    begin: int,
    samples: int,
) -> Tensor:
    """Return errors (B, K + 1, D) of the means of sampled paths, in their standard deviations.

    Paths begin at a time at which errors are still small, and have the same errors of the parameters before
    and after it. Errors before that time are NaN.

    Args:
        dynamics: float64 dynamics with a field.
        states: fitted paths, (B, N + 1, D).
        steps: steps between the K + 1 times.
        variances: variances of the forecasts, with the columns of their causes at `begin`.
        spread: factor L (P, R) of the covariance of the parameters.
        true: true states, (B, K + 1, D).
        begin: index of the time of the first random states.
        samples: number of paths of each trajectory.
    """
    first, off = int(steps.ends[begin]), torch.full_like(true, torch.nan)
    draws = drawn(
        states[:, first], samples, seed=0, own=variances.noise, common=variances.moved, spread=spread
    )
    ends = {int(end) - first: k for k, end in enumerate(steps.ends) if end >= first}
    for step, x in enumerate(sampled_paths(dynamics, draws, steps.lengths[:, first:])):
        if (k := ends.get(step)) is not None:
            mean, covariance = mixture_moments(x)
            off[:, k] = (true[:, k] - mean) / covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    return off
