"""Streams under controls: a Kalman filter with inputs, held commands, tables, kills, what is refused."""

from __future__ import annotations

import contextlib
import csv
import json
import math

import numpy as np
import pytest
import torch
from following import MEAN, P0, SPACE, STEP, Q
from hypothesis import given, settings
from hypothesis import strategies as st
from motions.pushed_spring import PushedSpring
from scipy.integrate import trapezoid
from steering import (
    GAINS,
    NAMES,
    Pushed,
    changes,
    commands,
    kalman,
    steered_filter,
    steered_session,
    written_commands,
)
from test_stream_of_lines import Killed, Pipe, killer

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.journal import Journal
from ahnn.controls import ControlTable
from ahnn.data.generate import generate
from ahnn.dynamics.flow_at_time import steered
from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.measurements import Position
from ahnn.systems import exact_flow
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.ukf import ForceError, UnscentedKalmanFilter, online_process

FOUND = commands(30)
TEXT = written_commands(FOUND)
MEASURED = [one._replace(controls=()) for one in FOUND if one.values]


def last(filtering, found):
    for reading in found:
        estimate = filtering.update(reading)
    return estimate


def same(one, other):
    return torch.equal(one.mean, other.mean) and torch.equal(one.covariance, other.covariance)


@pytest.mark.parametrize("estimator", [UnscentedKalmanFilter(), ExtendedKalmanFilter()])
def test_it_equals_a_kalman_filter_with_inputs_that_change_between_measurements(estimator):
    mean, covariance = kalman(FOUND)
    estimate = last(steered_filter(estimator), FOUND)
    assert np.allclose(estimate.mean, mean, rtol=1e-10, atol=0.0)
    assert np.allclose(estimate.covariance, covariance, rtol=1e-10, atol=0.0)
    still = [one._replace(controls=(0.0, 0.0)) if one.controls else one for one in FOUND]
    assert not np.allclose(kalman(still)[0], mean, rtol=1e-2)


def test_a_prediction_is_of_what_holds_at_each_time_before_it():
    filtering = steered_filter()
    filtering.update(Reading(0.0, controls=(1.0, 0.0)))
    filtering.update(Reading(0.7, controls=(None, 2.0)))
    estimate = filtering.update(Reading(1.9))
    gained = GAINS[0] * 1.9 + GAINS[1] * 2.0 * 1.2
    moved = GAINS[0] * 1.9**2 / 2 + GAINS[1] * 2.0 * 1.2**2 / 2
    assert estimate.outcome == "predicted"
    assert estimate.mean.tolist() == pytest.approx(
        [MEAN[0] + MEAN[1] * 1.9 + moved, MEAN[1] + gained], rel=1e-12
    )


def test_controls_of_a_table_give_the_bits_of_controls_that_readings_bring():
    brought, told = steered_filter(), steered_filter(controls=ControlTable.of(*changes(FOUND)))
    expected = [brought.update(one) for one in FOUND]
    expected = [estimate for one, estimate in zip(FOUND, expected, strict=True) if one.values]
    for one, estimate in zip(MEASURED, expected, strict=True):
        assert same(told.update(one), estimate)


def test_controls_that_a_table_interpolates_push_by_their_integral():
    table = ControlTable.of([0.0, 0.7, 3.0], [[0.0, 1.0], [2.0, 1.0], [-1.0, 0.0]], linear=True)
    estimate = steered_filter(controls=table).update(Reading(2.6))
    fine = np.linspace(0.0, 2.6, 200_001)
    pushed = sum(
        gain * np.interp(fine, table.times, column)
        for gain, column in zip(GAINS, table.values.T, strict=True)
    )
    assert float(estimate.mean[1]) == pytest.approx(MEAN[1] + trapezoid(pushed, fine), rel=1e-9)
    assert float(estimate.mean[0]) == pytest.approx(
        MEAN[0] + MEAN[1] * 2.6 + trapezoid(pushed * (2.6 - fine), fine), rel=1e-9
    )


def test_it_equals_the_filter_of_an_evaluation_under_the_same_controls():
    system = PushedSpring(name="pushed", dt=0.05, steps=60)
    data = generate(system, 1, seed=3)
    belief = initial_belief(data.states[:, 0] + 0.01, 1e-4 * np.eye(2))
    noise = 1e-3 * torch.randn(60, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    rows = (data.states[:, 1:, :1] + noise[None, :, None]).clone()
    rows[:, [k for k in range(60) if k % 4]] = torch.nan
    q, own = 1e-8 * torch.eye(2, dtype=torch.float64), UnscentedKalmanFilter()
    flow = steered(exact_flow(system), data.times[0], data.controls)
    known = own.run(flow, belief, rows, Position(1), q, 1e-6 * np.eye(1), 0.05)
    sensors = {"ruler": StreamSensor.of(Position(1), 1e-3, system.space)}
    filtering = Assimilation(online_process(own, exact_flow(system), 0.05, q), sensors, belief)
    for k, (time, u) in enumerate(zip(data.times[0].tolist(), data.controls[0].tolist(), strict=True)):
        value = float(rows[0, k - 1, 0]) if k else math.nan
        estimate = filtering.update(Reading(time, (value,), controls=tuple(u)))
        if k:
            assert torch.allclose(estimate.mean, known.means[0, k - 1], rtol=1e-9, atol=1e-12)
            assert torch.allclose(estimate.covariance, known.covariances[0, k - 1], rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("error", [None, ForceError(1e-9, 10.0)], ids=["bias", "bias and force error"])
def test_states_of_errors_are_carried_under_the_controls_too(error):
    sensors = {
        "ruler": StreamSensor.of(Position(1, "m"), 0.1, SPACE, bias_sd=1e-9),
        "radar": steered_filter().sensors["radar"],
    }
    estimate = last(steered_filter(error=error, sensors=sensors), FOUND)
    assert np.allclose(estimate.mean, kalman(FOUND)[0], rtol=1e-6, atol=0.0)


@settings(max_examples=15)
@given(st.permutations(range(1, 12)), st.integers(0, 3))
def test_lines_in_any_order_within_the_window_see_the_controls_of_their_times(order, seed):
    found = commands(10, seed)
    whole = last(steered_filter(window=100.0), found)
    mixed = last(steered_filter(window=100.0), [found[0], *(found[k] for k in order), *found[12:]])
    assert same(whole, mixed)
    late = last(steered_filter(window=100.0), [found[0], found[-1], *found[1:-1]])
    assert same(whole, late)


def test_a_line_with_other_controls_is_no_repetition():
    filtering = steered_filter(window=5.0)
    filtering.update(Reading(0.0, controls=(1.0, 0.0)))
    for controls, outcome in (((2.0, 0.0), "predicted"), ((2.0, 0.0), "repeated"), ((1.0, 1.0), "predicted")):
        assert filtering.update(Reading(1.0, controls=controls)).outcome == outcome
    assert filtering.window.controls == (1.0, 1.0)


@settings(max_examples=10)
@given(st.lists(st.integers(0, 39), min_size=1, max_size=4), st.booleans(), st.booleans())
def test_a_filter_under_controls_is_saved_and_goes_on_bit_for_bit(tmp_path_factory, cuts, ordered, ahead):
    path = tmp_path_factory.mktemp("state") / "it.state"
    found, options = FOUND, {"window": 2.0, "lines": 6}
    if ahead:
        found, options = MEASURED, options | {"controls": ControlTable.of(*changes(FOUND))}
    if not ordered:
        found = [found[0], *(found[k + 1] for k in (k ^ 1 for k in range(len(found) // 2 * 2 - 2)))]
    whole, parts = steered_filter(**options), steered_filter(**options)
    for k, reading in enumerate(found):
        a, b = whole.update(reading), parts.update(reading)
        if k in cuts:
            parts.save(path)
            parts = steered_filter(**options)
            parts.load(path)
            assert parts.window.controls == whole.window.controls
        assert same(a, b)


@settings(max_examples=8)
@given(st.lists(st.integers(0, 14), min_size=1, max_size=4), st.integers(1, 7), st.booleans())
def test_a_stream_with_controls_that_is_killed_ends_with_the_same_bytes(
    tmp_path_factory, kills, every, piped
):
    folder = tmp_path_factory.mktemp("kills")
    steered_session(TEXT, folder / "whole.csv", window=2.0).run()
    pipe = Pipe(TEXT.encode())
    names = folder / "parts.csv", folder / "parts.state", every
    for after in (*kills, math.inf):
        text = Journal(pipe, folder / "lines") if piped else TEXT
        with contextlib.suppress(Killed):
            steered_session(text, *names, window=2.0).run(killer(after))
    assert (folder / "parts.csv").read_bytes() == (folder / "whole.csv").read_bytes()


def rows_of(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_cells_objects_and_a_table_say_the_same(tmp_path):
    steered_session(TEXT, tmp_path / "cells.csv").run()
    objects = []
    for one in FOUND:
        row = {"time": one.time} | ({"sensor": one.sensor} if one.sensor else {})
        row |= {k: None if v != v else v for k, v in zip(("q", "p"), one.values, strict=False)}
        row |= {k: u for k, u in zip(NAMES, one.controls, strict=False) if u is not None}
        objects.append(json.dumps(row))
    steered_session("\n".join(objects), tmp_path / "objects.csv").run()
    table = ControlTable.of(*changes(FOUND))
    text = "\n".join(
        row.rpartition(",")[0].rpartition(",")[0] for row in written_commands(MEASURED).splitlines()
    )
    steered_session(text, tmp_path / "table.csv", controls=table).run()
    cells, others, told = (rows_of(tmp_path / f"{name}.csv") for name in ("cells", "objects", "table"))
    assert [{**row, "line": ""} for row in others] == [{**row, "line": ""} for row in cells]
    assert [{**row, "line": ""} for row in told] == [{**row, "line": ""} for row in cells if row["sensor"]]
    commanded = [row for row in cells if not row["sensor"]]
    assert {row["outcome"] for row in commanded} == {"predicted"}
    assert len(commanded) == sum(not one.values for one in FOUND)


def test_rows_added_to_a_table_are_gone_on_with_and_others_are_refused(tmp_path):
    times, values = changes(FOUND)
    cut = next(k for k, one in enumerate(MEASURED) if one.time > times[5])
    whole = steered_filter(controls=ControlTable.of(times, values))
    expected = last(whole, MEASURED)
    first = steered_filter(controls=ControlTable.of(times[:8], values[:8]))
    last(first, MEASURED[:cut])
    first.save(tmp_path / "a.state")
    again = steered_filter(controls=ControlTable.of(times, values))
    again.load(tmp_path / "a.state")
    assert same(last(again, MEASURED[cut:]), expected)
    other = [(9.0, 9.0), *values[1:]]
    for table in (ControlTable.of(times, other), ControlTable.of(times, values, linear=True), None):
        with pytest.raises(
            UserError, match=r"controls: expected the controls stored in .* up to time .*; received different"
        ):
            steered_filter(controls=table).load(tmp_path / "a.state")


def test_a_process_model_that_knows_its_controls_asks_for_none():
    flow = steered(Pushed(), [0.0], [[0.3, 0.1]])
    process = online_process(UnscentedKalmanFilter(), flow, STEP, Q)
    known = Assimilation(process, steered_filter().sensors, initial_belief([MEAN], P0))
    brought = steered_filter(controls=ControlTable.of([0.0], [[0.3, 0.1]]))
    assert same(last(known, MEASURED), last(brought, MEASURED))
