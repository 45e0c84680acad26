"""Another estimator online: nothing of a stream knows which one it is."""

from __future__ import annotations

import torch
from following import MEAN, P0, SENSORS, STEP, Q, coast, readings

from ahnn.assimilation import Assimilation, Reading
from ahnn.estimation import Gate, initial_belief
from ahnn.estimation.online import online_process
from ahnn_plugins.ekf import ExtendedKalmanFilter


def make(gate=None, **options):
    process = online_process(ExtendedKalmanFilter(gate), coast, STEP, Q)
    return Assimilation(process, SENSORS, initial_belief([MEAN], P0), **options)


def test_a_stream_that_is_saved_and_restored_at_any_reading_goes_on_bit_for_bit(tmp_path):
    found = readings(20)
    whole = make(window=1.0)
    expected = [whole.update(one) for one in found]
    for k in range(1, 20, 3):
        first = make(window=1.0)
        for one in found[:k]:
            first.update(one)
        first.save(tmp_path / "a.state")
        again = make(window=1.0)
        again.load(tmp_path / "a.state")
        for one, told in zip(found[k:], expected[k:], strict=True):
            estimate = again.update(one)
            assert torch.equal(estimate.mean, told.mean)
            assert torch.equal(estimate.covariance, told.covariance)


def test_its_gate_refuses_an_outlier():
    filtering = make(Gate(0.9999, 3))
    assert filtering.update(Reading(0.5, (1.1,), "ruler")).outcome == "taken"
    assert filtering.update(Reading(1.0, (1e3,), "ruler")).outcome == "rejected"
