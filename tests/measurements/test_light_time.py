"""Time of light between a station and a satellite."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from test_measurements import site

from ahnn.measurements import GroundStation


@pytest.mark.parametrize("event", ["receive", "transmit"])
def test_light_takes_its_time_there_and_back(event):
    """Against the two-way path solved by iteration, of a satellite on a circle at 42,000 km."""
    rate, t = math.sqrt(398600.4418 / 42000.0**3), 5000.0

    def satellite(time):
        c, s = math.cos(rate * time), math.sin(rate * time)
        return np.array([42000.0 * c, 42000.0 * s * 0.8, 42000.0 * s * 0.6])

    def light(away, begin, sign):
        end = begin
        for _ in range(6):
            end = begin + sign * np.linalg.norm(away(end)) / 299792.458
        return end

    here = site(30.0, -40.0, 0.0, t, 0.7)
    sign = -1.0 if event == "receive" else 1.0
    bounce = light(lambda time: satellite(time) - here, t, sign)
    other = light(lambda time: satellite(bounce) - site(30.0, -40.0, 0.0, time, 0.7), bounce, sign)
    c, s = math.cos(rate * t), math.sin(rate * t)
    velocity = 42000.0 * rate * np.array([-s, 0.8 * c, 0.6 * c])
    x = torch.from_numpy(np.concatenate((satellite(t), velocity)))
    seen = GroundStation(30.0, -40.0, earth_angle=0.7, event=event)(x, t)
    assert float(seen[0]) == pytest.approx(299792.458 * abs(other - t) / 2, abs=1e-5)
    plain = GroundStation(30.0, -40.0, earth_angle=0.7)
    there = torch.from_numpy(np.concatenate((satellite(bounce), velocity)))
    assert torch.allclose(seen[1:], plain(there, t)[1:], rtol=0, atol=1e-9)
    assert abs(float(seen[0] - plain(x, t)[0])) > 0.01
