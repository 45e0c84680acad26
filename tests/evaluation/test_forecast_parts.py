"""Parts of a trajectory in a forecast: the measurements of the fit, and the times of the tests."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import SPRING, Learned, trajectories

from ahnn.data.segments import whole
from ahnn.data.sensor import Sensor
from ahnn.evaluation.forecast import after_parts, first_part, forecast

LONG = dataclasses.replace(SPRING, steps=400)


def measured(truth):
    sensor = Sensor(SPRING.space, measured="position", noise=0.05, every=4)
    return whole(sensor.measure(truth, 0), sensor.instrument(SPRING.dt))


def test_halves_are_of_what_was_measured():
    segment = measured(trajectories(SPRING, 3, 1))
    values = segment.values.clone()
    values[0, :20] = torch.nan
    values[1, 10:] = torch.nan
    values[2] = torch.nan
    early = first_part(segment._replace(values=values), 0.5)
    there = ~values.isnan().all(-1)
    assert (early & there).sum(1).tolist() == [5, 5, 0]
    assert there.sum(1).tolist() == [11, 10, 0]
    assert bool(early[0, 24])
    assert not bool(early[0, 25:].any())


def test_parts_of_a_forecast_end_at_a_fifth_two_fifths_and_its_last_time():
    early = torch.arange(16) < torch.tensor([[6], [1]])
    values = torch.arange(16.0).expand(2, 16).unsqueeze(-1)
    assert after_parts(values, early).squeeze(-1).tolist() == [[7, 9, 15], [3, 6, 15]]


def test_a_start_is_fitted_to_a_part_and_states_after_parts_are_counted():
    truth = trajectories(LONG, 400, 3)
    segment = measured(truth)
    spread = torch.tensor([[1e-9]], dtype=torch.float64)
    found = forecast(Learned(LONG.stiffness), segment, spread, truth=truth, fitted=0.25)
    assert found is not None
    assert int(first_part(segment, 0.25)[0].sum()) == 25
    assert found.parts is not None
    assert found.single is not None
    assert [len(row) for row in found.single] == [2, 2, 2]
    for shares in found.parts:
        assert shares == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.05)
