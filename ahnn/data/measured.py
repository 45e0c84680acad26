"""Statistics of measurements: what `Statistics.of` says of states, without differences of noisy samples."""

from __future__ import annotations

import torch

from ahnn.measurements import Instrument
from ahnn.measurements.smoothing import Local, as_states, smoothed
from ahnn.statistics import Statistics
from ahnn.types import Trajectories

EXAMPLES = 4_000
"""Samples whose neighbourhood is smoothed."""


def smooth(measured: Trajectories, instrument: Instrument) -> Local:
    """Return polynomials at some of the samples."""
    return smoothed(instrument, measured.states, measured.times, EXAMPLES)


def measured_statistics(measured: Trajectories, instrument: Instrument) -> Statistics:
    """Return the statistics of measurements (B, T, M), read off polynomials that are local in time.

    Rates come from the polynomials and not from differences, which noise inflates.
    """
    times, local = measured.times, smooth(measured, instrument)
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
