"""Region covered by training on measurements: states along the fitted paths.

Before training, paths are known only from smoothed measurements, which are missing where samples are sparse,
for example near a perigee.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.robust import RobustName, loss_of
from ahnn.training.maximum_posterior import whole_problem

PATHS, STATES = 150, 50_000
"""Maximum number of training trajectories propagated, and of states returned."""


@torch.no_grad()
def fitted_states(dynamics: Dynamics, train: Segment, robust: RobustName) -> Tensor:
    """Return states (M, D), evenly spaced along the best-fitting paths; empty if no path fits.

    Args:
        dynamics: float64 dynamics with a field.
        train: all training measurements.
        robust: robust loss of residuals.
    """
    some = train.rows(slice(None, None, -(-len(train.times) // PATHS)))
    problem = whole_problem(dynamics, some, loss_of(robust, train.instrument.freedom))
    states, seen = problem.fitted.states[problem.kept], ~problem.batch.values.isnan().all(-1)
    last = (seen * problem.steps.ends).amax(1, keepdim=True)
    there = torch.arange(states.shape[1]) <= last
    met = states[there & states.isfinite().all(-1)]
    return met[:: -(-len(met) // STATES) or 1]
