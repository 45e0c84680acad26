"""Runtime estimate of the closing stage, in iterations of its fits of initial states.

An iteration is timed on the untrained dynamics, whose own fits would end early; the number of iterations is
that of typical trainings.
"""

from __future__ import annotations

import copy
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.data.datamodule import WindowDataModule
from ahnn.data.segments import Segments
from ahnn.dynamics import HasField
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.shooting.initial_states import Fitted, Trial, followed
from ahnn.shooting.path_sensitivities import Steps
from ahnn.shooting.quadrature import coarse
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.training.least_observable import INTERVALS as RANKED
from ahnn.training.least_observable import LASTING
from ahnn.training.maximum_posterior import WideProblem
from ahnn.training.timers import median_seconds, sum_seconds

FITS, ROBUST_FITS, STEP_FITS, EQUATIONS = 40.0, 65.0, 5.0, 5.0
"""Measured cost of the closing stage: iterations of all initial states without and with a robust loss and
for each parameter step, and accumulations of normal equations.
"""
DIRECTIONS = 1.0
"""Measured cost of a time step in the ranking of directions, in units of `sum_seconds`."""
QUARTERED = 4
"""Number of integrator steps in place of one that is too coarse for derivatives."""
ROWS = 100
"""Number of segments that together cost as much as the fixed part of a time step."""
SEGMENTS, INTERVALS = 300, 256
"""Maximum number of segments on which iterations are timed, and of their measurement intervals."""


class ShootingCost(NamedTuple):
    """Measured durations per unit of `work`, in seconds.

    Attributes:
        iteration: paths of segments, with their derivatives with respect to the initial states.
        equations: derivatives with respect to the parameters, and normal equations.
        quartered: whether the closing stage quarters the integrator steps.
    """

    iteration: float
    equations: float
    quartered: bool


def closing_seconds(cost: ShootingCost, times: Tensor, robust: RobustName, steps: int) -> float:
    """Return the time of the closing stage; its numbers of iterations are those of typical trainings.

    Args:
        cost: measured cost of an iteration.
        times: (B, T) times of all training measurements.
        robust: robust loss of residuals.
        steps: maximum number of parameter steps.
    """
    fits = (FITS if robust == "none" else ROBUST_FITS) + STEP_FITS * steps
    amount = work(times) * (QUARTERED if cost.quartered else 1)
    ranked = min(LASTING * times.shape[1], RANKED)
    return amount * (fits * cost.iteration + EQUATIONS * cost.equations) + DIRECTIONS * ranked * sum_seconds()


def work(times: Tensor) -> float:
    """Return the work of a batch of segments with these times (B, T), in steps of one segment."""
    rows, samples = times.shape
    return float(samples * (rows + ROWS))


class _Unfitted(WideProblem):
    """Problem at guessed initial states, which keeps diverging paths: its cost is that of any dynamics."""

    def fit(
        self, trial: Trial, starts: Tensor | None, batch: Segment, steps: Steps, hopeless: float
    ) -> Fitted:
        """Follow the guesses."""
        states, sums = followed(trial, guess(batch), batch, steps)
        return Fitted(states, torch.zeros_like(sums))


@torch.no_grad()
def shooting_cost(model: Any, data: WindowDataModule) -> ShootingCost:
    """Time an iteration of initial states, and normal equations, on the first intervals of trajectories."""
    dynamics = copy.deepcopy(model.dynamics).double().cpu()  # as in the closing stage
    whole = Segments(data.measured("train"), None, data.instrument)
    batch = whole.gather(torch.arange(min(len(whole), SEGMENTS)))
    batch = batch._replace(values=batch.values[:, : INTERVALS + 1], times=batch.times[:, : INTERVALS + 1])
    parameters = list(dynamics.parameters())
    theta, sizes = parameters_to_vector(parameters).detach(), [p.numel() for p in parameters]
    problem = _Unfitted(dynamics, batch, ROBUST["none"])
    whole_cost = median_seconds(lambda: problem.equations(theta.clone(), sizes))
    equations = median_seconds(lambda: problem.equations(theta, sizes))  # with the paths of the last call
    amount, states = work(batch.times), problem.fitted.states
    quartered = coarse(cast(HasField, dynamics).field, states, problem.steps.lengths)
    return ShootingCost(max(whole_cost - equations, 0.0) / amount, equations / amount, quartered)
