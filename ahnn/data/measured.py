"""Statistics of measurements: what `Statistics.of` says of states, without differences of noisy samples."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.measurements import Instrument
from ahnn.measurements.smoothing import Local, as_states
from ahnn.statistics import Statistics

EXAMPLES = 4_000
"""Samples whose neighbourhood is smoothed."""


def measured_statistics(local: Local, instrument: Instrument, times: Tensor) -> Statistics:
    """Return the statistics of measurements at times (B, T), read off polynomials that are local in time.

    Rates come from the polynomials and not from differences, which noise inflates.
    """
    states = as_states(local.value, local.rate, instrument)
    rates = as_states(local.rate, local.curvature, instrument)
    positions, forces = states.chunk(2, dim=-1)[0], rates.chunk(2, dim=-1)[1]
    radius = positions.norm(dim=-1)
    dt = float(times.diff(dim=1).nanmedian())
    rate = rates.square().mean(0).sqrt()
    return Statistics(
        minimum=states.amin(0),
        maximum=states.amax(0),
        increment=rate * dt,
        rate=rate,
        radius=torch.stack((radius.min(), radius.max())),
        positions=positions,
        forces=forces,
        dt=dt,
    )
