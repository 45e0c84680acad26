"""Pseudoranges to satellites, and the interpolation of their positions."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.measurements import GnssRange

F64 = torch.float64


def test_gnss_ranges_constant_and_tabulated():
    satellites = torch.tensor([[20000.0, 0.0, 0.0], [0.0, 20000.0, 0.0]], dtype=F64)
    x = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.0]], dtype=F64)
    expected = torch.tensor([[13000.0, math.hypot(7000.0, 20000.0)]], dtype=F64)
    assert torch.allclose(GnssRange(satellites)(x, 0.0), expected, rtol=1e-15)
    table = GnssRange(torch.stack((satellites, 2.0 * satellites)), times=[60.0, 120.0], order=1)
    assert torch.allclose(table(x, 60.0), expected, rtol=1e-15)
    assert float(table(x, 120.0 * (1.0 + 1e-15))[0, 0]) == pytest.approx(33000.0)
    with pytest.raises(ValueError, match="60 to 120; received 90"):
        table(x, 90.0)
    with pytest.raises(ValueError, match="expected positions"):
        GnssRange(table.positions)


def test_gnss_clock_is_a_component_of_the_state():
    x = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.0, 0.3]], dtype=F64)
    satellites = torch.tensor([[20000.0, 0.0, 0.0]], dtype=F64)
    assert float(GnssRange(satellites, clock=6)(x, 0.0)) == pytest.approx(13000.3, rel=1e-15)
