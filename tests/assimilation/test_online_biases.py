"""Sensors with biases in a stream: estimated with the state, saved with it, and part of what it is."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from following import MEAN, P0, SPACE, STEP, Q, coast, readings

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.measurements import Position, State
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

TRUE = 0.8


def make(estimator=None, **biases):
    """A ruler with a bias beside a radar without one."""
    sensors = {
        "ruler": StreamSensor.of(Position(1, "m"), 0.05, SPACE, **({"bias_sd": 1.0} | biases)),
        "radar": StreamSensor.of(State(1, ("m", "m/s")), [0.05, 0.05], SPACE),
    }
    process = online_process(estimator or UnscentedKalmanFilter(), coast, STEP, 1e-6 * Q)
    return Assimilation(process, sensors, initial_belief([MEAN], P0))


def seen(count=60):
    """Readings of a body that coasts, those of the ruler too long by TRUE."""
    return [
        one._replace(values=(one.values[0] + TRUE,)) if one.sensor == "ruler" else one
        for one in readings(count)
    ]


@pytest.mark.parametrize("estimator", [UnscentedKalmanFilter(), ExtendedKalmanFilter()])
def test_a_bias_is_found_with_its_deviation_and_the_state_is_free_of_it(estimator):
    filtering = make(estimator)
    assert filtering.biases == {"ruler": [(0.0, 1.0)]}
    for one in seen():
        estimate = filtering.update(one)
    ((bias, sd),) = filtering.biases["ruler"]
    assert abs(bias - TRUE) < 4 * sd < 0.2
    error = float(estimate.mean[0]) - (1.2 + 0.25 * estimate.time)
    assert abs(error) < 4 * float(estimate.covariance[0, 0]) ** 0.5
    assert estimate.mean.shape == (2,)


def test_a_stream_with_biases_is_saved_and_goes_on_bit_for_bit(tmp_path):
    found = seen(20)
    whole, first = make(bias_memory=30.0), make(bias_memory=30.0)
    expected = [whole.update(one) for one in found]
    for one in found[:9]:
        first.update(one)
    first.save(tmp_path / "a.state")
    again = make(bias_memory=30.0)
    again.load(tmp_path / "a.state")
    assert again.biases == first.biases
    for one, told in zip(found[9:], expected[9:], strict=True):
        assert torch.equal(again.update(one).mean, told.mean)
    for other in (make(), make(bias_memory=30.0, bias_sd=2.0)):
        with pytest.raises(UserError, match="saved with different values of sensor ruler"):
            other.load(tmp_path / "a.state")


def test_a_bias_that_wanders_is_open_again_after_its_memory():
    filtering = make(bias_memory=2.0)
    for one in seen(29):  # the last one of the ruler
        filtering.update(one)
    ((_, near),) = filtering.biases["ruler"]
    last = filtering.window.time
    filtering.update(Reading(last + 40.0, (np.nan, np.nan), "radar"))
    ((bias, sd),) = filtering.biases["ruler"]
    assert near < 0.5
    assert sd == pytest.approx(1.0, rel=1e-3)
    assert abs(bias) < 1e-6


def test_a_stream_goes_on_with_its_sensors_named_in_another_order(tmp_path):
    def ordered(names):
        made = {"left": 1.0, "right": 1.0}
        sensors = {name: StreamSensor.of(Position(1, "m"), 0.05, SPACE, bias_sd=made[name]) for name in names}
        process = online_process(UnscentedKalmanFilter(), coast, STEP, 1e-6 * Q)
        return Assimilation(process, sensors, initial_belief([MEAN], P0))

    one, other = ordered(["left", "right"]), ordered(["right", "left"])
    for k in range(6):
        one.update(Reading(0.5 * k, (1.2 + 0.1 * k + 0.3 * (k % 2),), ("left", "right")[k % 2]))
    one.save(tmp_path / "a.state")
    other.load(tmp_path / "a.state")
    assert other.biases == one.biases
