"""Oscillators with two parameters, and measurements of them: shooting without a network."""

from __future__ import annotations

import torch
from helpers import generator
from torch import nn

from ahnn.dynamics.base import Dynamics
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Instrument, Position, Segment
from ahnn.shooting.path_sensitivities import path, steps_between

DOUBLE = {"dtype": torch.float64}


class Oscillator(nn.Module):
    """dq/dt = p, dp/dt = -a q - b q^3."""

    def __init__(self, a, b):
        super().__init__()
        self.stiffness = nn.Parameter(torch.tensor([a, b], **DOUBLE))

    def forward(self, x):
        q, p = x.chunk(2, dim=-1)
        return torch.cat((p, -self.stiffness[0] * q - self.stiffness[1] * q**3), dim=-1)


class Swing(Dynamics):
    """An oscillator by RK4."""

    def __init__(self, a=2.0, b=0.5):
        super().__init__()
        self.field = Oscillator(a, b)

    def fit(self, statistics):
        pass

    def increment(self, x, dt):
        return INTEGRATORS["rk4"].increment(self.field, x, dt)


def times(rows, intervals, spacing=0.1):
    jitter = 0.5 + torch.rand(rows, intervals, generator=generator(3), **DOUBLE)
    return torch.cat((torch.zeros(rows, 1, **DOUBLE), (spacing * jitter).cumsum(1)), dim=1)


@torch.no_grad()
def segment(
    rows=6, intervals=20, measurement=None, sd=0.01, missing=0.2, dynamics=None, longest=0.02, seed=0
):
    """Measurements of oscillators with noise, at irregular times, some missing."""
    x = torch.randn(rows, 2, generator=generator(10 * seed), **DOUBLE)
    grid = times(rows, intervals)
    measurement = measurement or Position(1)
    sds = torch.full((len(measurement.names),), sd, **DOUBLE)
    instrument = Instrument(measurement, sds, longest, 1, 1.0)
    steps = steps_between(grid, longest)
    states = path((dynamics or Swing()).increment, x, steps.lengths)[:, steps.ends]
    values = measurement(states, grid)
    values = values + sd * torch.randn(values.shape, generator=generator(10 * seed + 1), **DOUBLE)
    gone = torch.rand(values.shape, generator=generator(10 * seed + 2)) < missing
    gone[:, :6] = False
    return x, Segment(values.masked_fill(gone, torch.nan), grid, instrument)
