"""Which parameters measurements tell least: a filter that follows more of their kind has them as states."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.initial_states import LOST
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.training.shooting import ShootingProblem
from ahnn.uncertainty.directions import ARCS, MOST, Watched, filtered_directions

INTERVALS = 2000
"""Measurement intervals of a trajectory that are looked at, at most."""


@torch.no_grad()
def least_told(dynamics: Dynamics, spread: Tensor, train: Segment, robust: RobustName) -> Tensor | None:
    """Return the directions (P, K) of the parameters that a filter tells least from such measurements.

    It follows some trajectories of the training, from starts as uncertain as states are large.

    Args:
        dynamics: with a field, float64.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        train: all measurements of the training.
        robust: the loss of single residuals.

    Returns:
        None where the dynamics meet none of these trajectories.
    """
    some = train.first(INTERVALS).rows(slice(None, None, max(1, len(train.times) // ARCS)))
    met = ShootingProblem(dynamics, some, ROBUST[robust], LOST)
    if not len(met.starts):
        return None
    sizes = met.fitted.states[met.kept].unflatten(-1, (2, -1)).square().nanmean((0, 1, 3)).sqrt()
    watched = Watched(met.starts, sizes.repeat_interleave(train.instrument.dof), met.batch)
    return filtered_directions(dynamics, spread, watched, MOST).directions
