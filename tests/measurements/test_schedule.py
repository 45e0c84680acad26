"""When measurements come."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.measurements import every, schedule

F64 = torch.float64
ROWS = torch.arange(8.0, dtype=F64).reshape(2, 4, 1)


def test_every_kth_step():
    rows = every(torch.ones(2, 7, 1), 3)
    assert torch.isfinite(rows[0, :, 0]).nonzero().flatten().tolist() == [2, 5]
    with pytest.raises(ValueError, match="received 0"):
        every(rows, 0)


def test_schedule_hits_every_measurement():
    times = torch.tensor([2.0, 2.5, 60.0 + 1e-14, 120.0], dtype=F64)
    values = torch.arange(4.0, dtype=F64).reshape(1, 4, 1)
    dt, rows = schedule(times, values, max_step=30.0, start_time=1.0)
    ends = 1.0 + dt.cumsum(0)
    present = torch.isfinite(rows[0, :, 0])
    assert torch.allclose(ends[present], times, rtol=1e-14)
    assert torch.equal(rows[0, present], values[0])
    assert float(dt.max()) <= 30.0 * (1.0 + 1e-9)
    assert dt.tolist() == [1.0, 0.5, *[pytest.approx(28.75)] * 2, *[pytest.approx(30.0)] * 2]
    with pytest.raises(ValueError, match="increasing"):
        schedule(times.flip(0), values, 30.0)
    with pytest.raises(ValueError, match=r"measurements \(B, K, M\); received \(3,\) and"):
        schedule(times[:3], values, 30.0)


@pytest.mark.parametrize("k", [0, -3, 2.5, math.nan, math.inf])
def test_a_cadence_is_a_whole_number_of_steps(k):
    with pytest.raises(ValueError, match=f"every: expected a whole number of steps.* received {k}"):
        every(ROWS, k)


def test_a_schedule_of_lists():
    dt, rows = schedule([1.0, 3.0], ROWS[:, :2].tolist(), 1)
    assert dt.tolist() == [1.0, 1.0, 1.0]
    assert torch.equal(rows[:, [0, 2]], ROWS[:, :2])
    with pytest.raises(ValueError, match=r"every: expected measurements \(B, T, M\); received \(2, 4\)"):
        every(ROWS[..., 0], 2)


@pytest.mark.parametrize(
    ("times", "max_step", "start_time", "message"),
    [
        ([1.0, 2.0], math.nan, 0.0, "max_step > 0; received .* max_step nan"),
        ([1.0, 2.0], 1.0, math.nan, "increasing from nan"),
        ([1.0, math.inf], 1.0, 0.0, "expected times increasing"),
        ([1.0, 1.0], 1.0, 0.0, "expected times increasing from 0 .* smallest gap 0"),
        ([1.0, 2.0], 1.0, 1.0, "expected times increasing from 1 .* smallest gap 0"),
        ([[1.0, 2.0]], 1.0, 0.0, r"expected times \(K,\) .* received \(1, 2\)"),
        ("now", 1.0, 0.0, "schedule: times: expected numbers"),
    ],
)
def test_mistakes_of_a_schedule(times, max_step, start_time, message):
    with pytest.raises(ValueError, match=message):
        schedule(times, ROWS[:, :2], max_step, start_time)


@pytest.mark.parametrize("max_step", [0.0, -1.0, float("nan")])
def test_steps_of_no_length_are_refused(max_step):
    with pytest.raises(ValueError, match=f"max_step > 0; received smallest gap 1 and max_step {max_step:g}"):
        schedule([1.0, 2.0], torch.zeros(1, 2, 1), max_step)


def test_a_cadence_of_one_keeps_every_row():
    assert torch.equal(every(ROWS, 1), ROWS)
    assert bool(every(ROWS, 5).isnan().all())
