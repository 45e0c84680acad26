"""The parameters of a model as states of a filter: in an evaluation, and online, without truth."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.data.segments import whole
from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.estimation.scenario import Setting, simulated
from ahnn.evaluation import Case
from ahnn.evaluation.explained import LOST, fit_to
from ahnn.measurements import Instrument, Segment
from ahnn.types import Trajectories
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf.directions import Watched, filtered_directions
from ahnn_plugins.ukf.parameter_error import ParameterError, field_columns

ARCS = 12
"""Training trajectories, about, along which the directions of the parameters are weighed."""
INTERVALS = 2000
"""Intervals of them, at most."""
MOST = 50
"""Directions of the parameters that a filter has as states, at most."""
ENOUGH = 0.01
"""What other directions may add to the NEES, per state component, where what a filter sees is known."""

Growth = Callable[[Tensor], Tensor]
"""States (..., D) -> factor (...) on what the parameters do there."""


def simulated_filter(case: Case, setting: Setting) -> Watched:
    """Return training trajectories as the filter of an evaluation sees them."""
    states = case.train.states[:: max(1, len(case.train.states) // ARCS)]
    states = states[states[:, 0].isfinite().all(-1)]
    dt = cast(float, case.dt)
    times = dt * torch.arange(states.shape[1], dtype=states.dtype).expand(len(states), -1)
    values = pad(simulated(setting, states, dt, seed=0), (0, 0, 1, 0), value=torch.nan)
    instrument = Instrument(
        setting.measurement, setting.measurement_sd, dt, case.space.dof, case.space.inertia
    )
    return Watched(states[:, 0], setting.start_sd, Segment(values, times, instrument))


def learned_filter(case: Case) -> Watched:
    """Return training trajectories as measurements show them, from starts as uncertain as they are large.

    Raises:
        UserError: there are none, or the model does not meet them.
    """
    if case.learned_from is None:
        message = (
            "data.noise: expected that of the measurements that the model was learned from; received null"
        )
        raise UserError(message)
    values, times, instrument = case.learned_from
    segment = whole(Trajectories(values, times), instrument).first(INTERVALS)
    segment = segment.rows(slice(None, None, max(1, len(segment.times) // ARCS)))
    fitted, _ = fit_to(cast(torch.nn.Module, case.flow), segment, case.robust)
    met = fitted.sums <= LOST * segment.measured
    if not bool(met.any()):
        message = (
            "process_noise: expected a model that meets the measurements that it was learned from; "
            f"received one that meets none of {len(met)} trajectories"
        )
        raise UserError(message)
    starts = fitted.starts[met]
    sizes = starts.unflatten(-1, (2, -1)).square().mean((0, 2)).sqrt()
    return Watched(starts, sizes.repeat_interleave(case.space.dof), segment.rows(met))


def parameters_as_states(
    case: Case, uncertainty: Uncertainty, watched: Watched, growth: Growth | None = None, enough: float = 0.0
) -> ParameterError:
    """Return the learned parameters of a case as states of a filter.

    Args:
        case: the model.
        uncertainty: of its parameters.
        watched: what the filter follows.
        growth: factor on what the parameters do at a state; None is 1 everywhere.
        enough: see `filtered_directions`.
    """
    dynamics, known = uncertainty.before or (cast(Dynamics, case.flow), uncertainty)
    directions, left_out = filtered_directions(dynamics, known.spread, watched, MOST, enough)
    plain = field_columns(dynamics, directions)

    def columns(x: Tensor) -> Tensor:
        return plain(x) if growth is None else growth(x)[..., None, None] * plain(x)

    name = hashlib.blake2b(directions.numpy().tobytes(), digest_size=16).hexdigest()
    return ParameterError(columns, directions.shape[1], left_out=left_out, name=name)
