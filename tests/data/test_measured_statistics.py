"""Statistics of noisy measurements: forces are told only where a polynomial follows the motion."""

from __future__ import annotations

import torch
from helpers import generator

from ahnn.data.measured import measured_statistics
from ahnn.measurements import Instrument, Position
from ahnn.measurements.smoothing import smoothed

SD = 1e-3


def turning(rows=40):
    """Positions sqrt(t^2 + e^2), straight but for a sharp turn at t = 0, where the force is 1 / e."""
    times = torch.linspace(-3.0, 3.0, 121, dtype=torch.float64).expand(rows, -1)
    values = (times**2 + 0.05**2).sqrt().unsqueeze(-1)
    values = values + SD * torch.randn(values.shape, generator=generator(0), dtype=torch.float64)
    return values, times


def test_forces_are_told_where_a_polynomial_follows_the_motion():
    values, times = turning()
    instrument = Instrument(Position(1), torch.tensor([SD], dtype=torch.float64), 0.05, 1, 1.0)
    local = smoothed(instrument, values, times, 2_000)
    found = measured_statistics(local, instrument, times)
    exact = 0.05**2 / found.positions**3
    assert 0.75 < len(found.forces) / len(local.value) < 0.99
    assert float(found.positions.abs().min()) > 2 * 0.05
    assert float((found.forces - exact).abs().max()) < 0.2 / 0.05
    assert float(found.minimum[0]) < 2 * 0.05  # extremes are those of all samples
