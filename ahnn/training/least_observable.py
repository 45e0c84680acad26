"""Least observable parameter directions, which become states of a filter on similar measurements."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.initial_states import LOST
from ahnn.shooting.robust import RobustName, loss_of
from ahnn.training.shooting import ShootingProblem
from ahnn.uncertainty.directions import ARCS, MOST, Watched, filtered_directions

INTERVALS = 2000
"""Maximum number of measurement intervals considered per trajectory."""


@torch.no_grad()
def least_observable_directions(
    dynamics: Dynamics, spread: Tensor, train: Segment, robust: RobustName, learned: Dynamics
) -> Tensor | None:
    """Return the parameter directions (P, K) least observable by a filter from such measurements.

    Simulates the filter on some training trajectories, with initial uncertainty as large as the states.

    Args:
        dynamics: float64 dynamics with a field, whose parameters are uncertain.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        train: all training measurements.
        robust: robust loss.
        learned: dynamics of the paths, after the step in function space, if any.

    Returns:
        None if the dynamics fit none of these trajectories.
    """
    some = train.first(INTERVALS).rows(slice(None, None, max(1, len(train.times) // ARCS)))
    loss = loss_of(robust, train.instrument.freedom)
    met = ShootingProblem(learned, some, loss, LOST)
    if not len(met.starts):
        return None
    sizes = met.fitted.states[met.kept].unflatten(-1, (2, -1)).square().nanmean((0, 1, 3)).sqrt()
    watched = Watched(met.starts, sizes.repeat_interleave(train.instrument.dof), met.batch)
    return filtered_directions(dynamics, spread, watched, MOST, learned=learned).directions
