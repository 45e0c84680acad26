"""Statistics of measurements, like `Statistics.of` for states, but without differences of noisy samples."""

from __future__ import annotations

import torch

from ahnn.measurements import Instrument, Observations
from ahnn.measurements.smoothing import Local, as_states, scale_of
from ahnn.statistics import Statistics

EXAMPLES = 4_000
"""Number of samples whose neighbourhood is smoothed."""
UNTRUE = 5.0
"""Multiple of the median error in predicting the central sample above which a polynomial is too stiff."""


def measured_statistics(local: Local, instrument: Instrument, measured: Observations) -> Statistics:
    """Compute the statistics of measurements from local polynomials in time.

    Rates are from polynomials, since noise inflates differences; individual forces are used only where a
    polynomial predicts its central sample about as well as most polynomials do.
    """
    states = as_states(local.value, local.rate, instrument)
    rates = as_states(local.rate, local.curvature, instrument)
    sds = as_states(local.rate_sd, local.curvature_sd, instrument)
    radius = states.chunk(2, dim=-1)[0].norm(dim=-1)
    error = (local.error / scale_of(local)).norm(dim=-1)
    true = error <= UNTRUE * error.median()
    dt = float(measured.times.diff(dim=1).nanmedian())
    assert local.chosen is not None
    row, column = local.chosen[true].unbind(-1)
    rate = rates.square().mean(0).sqrt()
    return Statistics(
        minimum=states.amin(0),
        maximum=states.amax(0),
        increment=rate * dt,
        rate=rate,
        radius=torch.stack((radius.min(), radius.max())),
        positions=states[true].chunk(2, dim=-1)[0],
        velocities=rates[true].chunk(2, dim=-1)[0],
        forces=rates[true].chunk(2, dim=-1)[1],
        clock=measured.times[row, column].unsqueeze(-1),
        dt=dt,
        force_sd=sds[true].chunk(2, dim=-1)[1],
    )
