"""The filter online equals a Kalman filter, the batch filter, and itself: late or restored."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from following import MEAN, P0, SD, SENSORS, SPACE, STEP, Q, coast, make, readings
from hypothesis import given, settings
from hypothesis import strategies as st

import ahnn
from ahnn.assimilation import Assimilation, Process, Reading, StreamSensor
from ahnn.assimilation.online import Diverged
from ahnn.errors import UserError
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import GroundStation, Position, Several, schedule
from ahnn_plugins.ukf import (
    ForceError,
    ParameterError,
    UnscentedKalmanFilter,
    online_process,
    unscented_filter,
)


def kalman(found):
    """Mean and covariance by the textbook's Kalman filter, Q of each step in proportion to its length."""
    x, p, now = np.array(MEAN), P0.copy(), 0.0
    for reading in found:
        count = max(1, math.ceil((reading.time - now) / STEP - 1e-9))
        h = (reading.time - now) / count
        f = np.array([[1.0, h], [0.0, 1.0]])
        for _ in range(count):
            x, p = f @ x, f @ p @ f.T + Q * h / STEP
        now = reading.time
        there = ~np.isnan(reading.values)
        c = np.eye(2)[: len(there)][there]
        r = np.diag(np.square(SENSORS[reading.sensor].deviations)[there])
        gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
        x, p = x + gain @ (np.array(reading.values)[there] - c @ x), p - gain @ c @ p
    return x, p


def last(filtering, found):
    for reading in found:
        estimate = filtering.update(reading)
    return estimate


def same(one, other):
    return torch.equal(one.mean, other.mean) and torch.equal(one.covariance, other.covariance)


def test_it_equals_the_kalman_filter_at_irregular_times_with_two_sensors_and_missing_numbers():
    found = readings(40)
    mean, covariance = kalman(found)
    estimate = last(make(), found)
    assert np.allclose(estimate.mean, mean, rtol=1e-11, atol=0.0)
    assert np.allclose(estimate.covariance, covariance, rtol=1e-10, atol=0.0)
    assert estimate.time == found[-1].time


def test_the_deviation_of_an_innovation_is_that_of_prediction_and_noise():
    told = make().update(Reading(0.0, (2.0,), "ruler")).innovation
    assert float(told.residual) == pytest.approx(1.0, rel=1e-14)
    assert float(told.deviation) == pytest.approx(math.sqrt(0.5 + SD**2), rel=1e-14)
    assert float(told.nis) == pytest.approx(1.0 / (0.5 + SD**2), rel=1e-13)


def pushes(x):
    """What two parameters add to the field at states of orbits."""
    return 1e-6 * torch.stack((x, x.flip(-1)), -1)


@pytest.mark.parametrize(
    "error",
    [None, ForceError(1e-3, 1800.0), ParameterError(pushes, 2)],
    ids=["additive", "with memory", "of parameters"],
)
def test_it_equals_the_batch_filter_with_a_learned_flow(error):
    run = ahnn.load("molniya_mechanical")
    start = torch.tensor([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]], dtype=torch.float64)
    belief = initial_belief(start, torch.diag(torch.tensor([1.0] * 3 + [1e-4] * 3)))
    times = torch.tensor([10.0, 70.0, 70.5, 250.0, 400.0, 430.0], dtype=torch.float64)
    rows = torch.cat([run.rollout(start, 1, float(t))[:, 1:, :3] for t in times], dim=1)
    rows[0, 2, 1] = torch.nan
    q = torch.diag(torch.tensor([1e-4] * 3 + [1e-8] * 3, dtype=torch.float64))
    process = online_process(UnscentedKalmanFilter(), run.dynamics, 60.0, q, error)
    sensors = {"gnss": StreamSensor.of(Position(), 0.1, run.space)}
    filtering = Assimilation(process, sensors, belief)
    for time, values in zip(times.tolist(), rows[0].tolist(), strict=True):
        estimate = filtering.update(Reading(time, tuple(values)))
    steps, r = schedule(times, rows, 60.0), 0.01 * torch.eye(3, dtype=torch.float64)
    if error is None:
        flow, start, seen = run.dynamics, belief, Position()
    else:
        flow, start, seen = error.flow(run.dynamics), error.belief(belief), error.measurement(Position())
    noise = lambda dt: q * dt / 60.0 if error is None else error.process_noise(q * dt / 60.0, dt)  # noqa: E731
    batch = unscented_filter(flow, start, steps.measurements, seen, noise, r, steps.dt)
    mean, covariance = batch.means[0, -1, :6], batch.covariances[0, -1, :6, :6]
    sd = covariance.diagonal().sqrt()
    assert float(((estimate.mean - mean) / mean).abs().max()) < 1e-12
    assert float(((estimate.covariance - covariance) / torch.outer(sd, sd)).abs().max()) < 1e-10


@settings(max_examples=15)
@given(st.permutations(range(8)), st.integers(0, 3))
def test_readings_in_any_order_within_the_window_give_the_same_bits(order, seed):
    found = readings(9, seed)
    whole = last(make(window=100.0), found)
    mixed = last(make(window=100.0), [*(found[k] for k in order), found[8]])
    assert same(whole, mixed)
    late = last(make(window=100.0), [found[8], *(found[k] for k in order)])
    assert same(whole, late)
    assert late.time == found[8].time


@settings(max_examples=10)
@given(st.lists(st.integers(0, 29), min_size=1, max_size=4), st.booleans())
def test_a_filter_that_is_saved_and_loaded_goes_on_bit_for_bit(tmp_path_factory, cuts, ordered):
    found, path = readings(30), tmp_path_factory.mktemp("state") / "it.state"
    if not ordered:
        found = [found[k ^ 1] for k in range(30)]
    options = {"window": 2.0, "lines": 6, "gate": Gate(0.999)}
    whole, parts = make(**options), make(**options)
    for k, reading in enumerate(found):
        a, b = whole.update(reading), parts.update(reading)
        if k in cuts:
            parts.save(path, {"line": str(k)})
            parts = make(**options)
            assert parts.load(path)["line"] == str(k)
    assert same(a, b)
    assert len(parts.window.entries) <= 6


def test_what_is_late_early_or_there_already_leaves_the_estimate_as_it_was():
    filtering = make(window=1.0, gap=50.0)
    before = last(filtering, [Reading(t, (1.0 + 0.3 * t,), "ruler") for t in (1.0, 2.0, 3.0)])
    for time, outcome in ((1.9, "late"), (53.5, "ahead"), (3.0, "repeated"), (2.0, "repeated")):
        estimate = filtering.update(Reading(time, (1.0 + 0.3 * time,), "ruler"))
        assert (estimate.outcome, estimate.innovation) == (outcome, None)
        assert same(estimate, before)
    merged = filtering.update(Reading(2.0, (1.7,), "ruler"))  # another number at a time that is taken
    assert (merged.outcome, merged.replayed, merged.time) == ("taken", 1, 3.0)
    assert filtering.update(Reading(2.5, (math.nan,), "ruler")).outcome == "predicted"


def test_outliers_are_rejected_and_too_many_end_the_filter_as_it_was():
    filtering = make(gate=Gate(0.9999, 3))
    for time in (1.0, 2.0):
        assert filtering.update(Reading(time, (1e3,), "ruler")).outcome == "rejected"
    before = filtering.window
    with pytest.raises(Diverged, match="DIVERGED at time 3, by sensor ruler"):
        filtering.update(Reading(3.0, (1e3,), "ruler"))
    assert filtering.window is before


def test_a_state_of_something_else_is_refused(tmp_path):
    path = tmp_path / "it.state"
    make(window=1.0).save(path)
    for other, names in (
        (make(window=2.0), "window"),
        (make(window=1.0, gate=Gate()), "gate"),
        (make(), "window"),
    ):
        with pytest.raises(UserError, match=f"saved with different values of {names}\\. Repeat"):
            other.load(path)
    path.write_bytes(path.read_bytes()[:-50])
    for damaged in (path, tmp_path / "none.state"):
        with pytest.raises(UserError, match="expected a file written by save"):
            make(window=1.0).load(damaged)


def test_the_identity_of_a_filter_is_that_of_its_parts_and_not_of_its_objects():
    def identity(latitude):
        station = Several([GroundStation(latitude, 13.0), GroundStation(0.0, 0.0)])
        sensors = {"net": StreamSensor.of(station, 0.1, SPACE)}
        process = Process(UnscentedKalmanFilter(), coast, lambda _: Q, STEP)
        return Assimilation(process, sensors, initial_belief([MEAN], P0)).identity

    assert identity(52.0) == identity(52.0) != identity(52.1)


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        (Reading(1.0, (1.0,), "sonar"), "sensor: expected one of ruler, radar; received 'sonar'"),
        (Reading(1.0, (1.0,)), "sensor: expected one of ruler, radar"),
        (Reading(1.0, (1.0, 2.0), "ruler"), "reading: expected a time and q"),
        (Reading(math.nan, (1.0,), "ruler"), "reading: expected a finite time"),
    ],
)
def test_a_reading_that_is_none_is_refused(reading, message):
    with pytest.raises(UserError, match=message):
        make().update(reading)


def test_wrong_limits_and_starts_of_several_are_refused():
    with pytest.raises(UserError, match="window: expected float >= 0"):
        make(window=-1.0)
    process = online_process(UnscentedKalmanFilter(), coast, STEP, Q)
    with pytest.raises(UserError, match="start: expected a belief about one state"):
        Assimilation(process, SENSORS, initial_belief([MEAN, MEAN], P0))
