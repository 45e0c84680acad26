"""Learned parameters as filter states, in directions chosen by their observability."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.dynamics import Dynamics
from ahnn.estimation.parameter_error import ParameterError, field_columns
from ahnn.estimation.scenario import Setting, simulated
from ahnn.evaluation import Case
from ahnn.measurements import Instrument, Segment
from ahnn.uncertainty.directions import ARCS, Chosen, Watched

ENOUGH = 0.01
"""Maximum NEES contribution of omitted directions per state component, if the filter's data are known."""


def simulated_filter(case: Case, setting: Setting) -> Watched:
    """Simulate measurements of training trajectories with the schedule of the evaluation's filter."""
    states = case.train.states[:: max(1, len(case.train.states) // ARCS)]
    states = states[states[:, 0].isfinite().all(-1)]
    dt = cast(float, case.dt)
    times = dt * torch.arange(states.shape[1], dtype=states.dtype).expand(len(states), -1)
    values = pad(simulated(setting, states, dt, seed=0), (0, 0, 1, 0), value=torch.nan)
    instrument = Instrument(
        setting.measurement, setting.measurement_sd, dt, case.space.dof, case.space.factor
    )
    return Watched(states[:, 0], setting.start_sd, Segment(values, times, instrument))


def parameters_as_states(
    dynamics: Dynamics, chosen: Chosen, growth: Callable[[Tensor], Tensor] | None = None
) -> ParameterError:
    """Build the model of learned parameters as filter states.

    Args:
        dynamics: dynamics with the parameters.
        chosen: chosen directions, and the NEES contribution of the omitted ones.
        growth: factor (...) on the effect of the parameters at states (..., D); None for 1 everywhere.
    """
    directions, left_out = chosen
    plain = field_columns(dynamics, directions)

    def columns(x: Tensor) -> Tensor:
        return plain(x) if growth is None else growth(x)[..., None, None] * plain(x)

    name = hashlib.blake2b(directions.numpy().tobytes(), digest_size=16).hexdigest()
    return ParameterError(columns, directions.shape[1], left_out=left_out, name=name)
