"""Where a training on measurements was: the states along the paths that it fitted.

Before the training nothing but smoothed measurements says where paths lead, and where samples lie apart, as
past a perigee, these are not there.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.training.maximum_posterior import whole_problem

PATHS, STATES = 150, 50_000
"""Trajectories of the training that are followed, and states of these that are returned, at most."""


@torch.no_grad()
def fitted_states(dynamics: Dynamics, train: Segment, robust: RobustName) -> Tensor:
    """Return states (M, D), evenly chosen along the paths that fit measurements best; none where none do.

    Args:
        dynamics: with a field, float64.
        train: all measurements of the training.
        robust: the loss of single residuals.
    """
    some = train.rows(slice(None, None, -(-len(train.times) // PATHS)))
    problem = whole_problem(dynamics, some, ROBUST[robust])
    states, seen = problem.fitted.states[problem.kept], ~problem.batch.values.isnan().all(-1)
    last = (seen * problem.steps.ends).amax(1, keepdim=True)
    there = torch.arange(states.shape[1]) <= last
    met = states[there & states.isfinite().all(-1)]
    return met[:: -(-len(met) // STATES) or 1]
