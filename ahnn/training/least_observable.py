"""Least observable parameter directions, which become states of a filter on similar measurements."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.shooting.initial_states import LOST
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.shooting.robust import RobustName, loss_of
from ahnn.training.shooting import ShootingProblem
from ahnn.uncertainty.directions import ARCS, Watched, filtered_directions

INTERVALS = 3000
"""Maximum number of measurement intervals considered per trajectory."""
LASTING = 4
"""Duration of the simulated streams, in durations of a training segment: streams last longer than segments,
and errors of the force recur on every revolution.
"""
MOST = 120
"""Maximum number of directions saved for streams."""
ENOUGH = 1e-3
"""Tolerated contribution of the omitted directions to the NEES, per state component."""


@torch.no_grad()
def least_observable_directions(
    dynamics: Dynamics, spread: Tensor, train: Segment, robust: RobustName, learned: Dynamics
) -> Tensor | None:
    """Return the parameter directions (P, K) least observable by a filter from such measurements.

    Simulates the filter on some training trajectories, continued beyond their ends, with initial uncertainty
    as large as the states.

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
    start_sd = sizes.repeat_interleave(train.instrument.dof)
    watched = Watched(met.starts, start_sd, continued(learned, met.starts, met.batch))
    return filtered_directions(dynamics, spread, watched, MOST, ENOUGH, learned).directions


def continued(dynamics: Dynamics, starts: Tensor, segment: Segment) -> Segment:
    """Return segments repeated in time, with their pattern of measurements, while all paths are finite."""
    times, values = segment.times, segment.values
    repeats = min(LASTING, INTERVALS // max(1, times.shape[1] - 1)) if not dynamics.clock else 1
    span = times[:, -1:] - times[:, :1] + times.diff(dim=1).median(1, keepdim=True).values
    for count in range(repeats, 1, -1):
        later = torch.cat([times + k * span for k in range(count)], dim=1)
        longer = segment._replace(times=later, values=values.repeat(1, count, 1))
        steps = steps_between(later, segment.instrument.longest)
        if path(dynamics.increment, starts, steps.lengths).isfinite().all():
            return longer
    return segment
