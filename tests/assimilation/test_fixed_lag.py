"""Estimates smoothed with a lag, beside the smoother of the whole arc so far; modes and lag in the output."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
import torch
from following import MEAN, P0, SENSORS, SPACE, STEP, Q, coast, readings

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session
from ahnn.errors import UserError
from ahnn.estimation import Gate, initial_belief
from ahnn.estimation.online import online_process
from ahnn.estimation.smoother import smoother
from ahnn.measurements import Position
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter
from ahnn_plugins.imm import InteractingModels
from ahnn_plugins.ukf import UnscentedKalmanFilter

RULER = {"ruler": StreamSensor.of(Position(1, "m"), 0.1, SPACE)}


def swing(x, dt):
    """A pendulum by semi-implicit Euler: not linear."""
    p = x[:, 1] - dt * x[:, 0].sin()
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


def make(estimator, sensors=RULER, flow=swing, **options):
    process = online_process(estimator, flow, STEP, Q)
    return Assimilation(process, sensors, initial_belief([MEAN], P0), **options)


@pytest.mark.parametrize("estimator", [UnscentedKalmanFilter(), ExtendedKalmanFilter()])
@pytest.mark.parametrize("lag", [2.0, 2.3])
def test_a_lag_smooths_as_the_smoother_of_all_readings_so_far(estimator, lag):
    rows = 1.0 + 0.5 * np.random.default_rng(2).normal(size=20)
    filtering, start = make(estimator, lag=lag), initial_belief([MEAN], P0)
    for k in range(1, 21):
        told = filtering.update(Reading(k * STEP, (rows[k - 1],))).smoothed
        back = int(np.ceil(lag / STEP))  # readings since
        if k < back:
            assert told is None
            continue
        data = torch.tensor(rows[None, :k, None])
        result = estimator.run(swing, start, data, Position(1), Q, [[0.01]], STEP, smoothing=True)
        arc = smoother(result)
        mean = arc.means[0, k - back - 1] if k > back else arc.initial.mean[0]
        chol = arc.chols[0, k - back - 1] if k > back else arc.initial.chol[0]
        assert told.time == (k - back) * STEP
        torch.testing.assert_close(told.belief.mean[0], mean, rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(told.belief.covariance[0], chol @ chol.T, rtol=1e-9, atol=1e-12)


def test_late_readings_count_for_what_is_smoothed_and_a_state_goes_on_bit_for_bit(tmp_path):
    found = readings(20)
    late = [*found[:10], found[11], found[10], *found[12:]]
    options = {"sensors": SENSORS, "flow": coast, "lag": 3.0, "window": 2.0}
    ours, theirs = (make(UnscentedKalmanFilter(), **options) for _ in range(2))
    for one in found[:15]:
        ours.update(one)
    for one in late[:15]:
        theirs.update(one)
    theirs.save(tmp_path / "state")
    again = make(UnscentedKalmanFilter(), **options)
    again.load(tmp_path / "state")
    for one in found[15:]:
        a, b = ours.update(one).smoothed, again.update(one).smoothed
        assert a.time == b.time
        assert torch.equal(a.belief.mean, b.belief.mean)
        assert torch.equal(a.belief.chol, b.belief.chol)


def test_nothing_is_smoothed_over_a_gate_that_reopened():
    filtering = make(ExtendedKalmanFilter(Gate(0.999999, 2, reopens=True)), flow=coast, lag=1.0)
    told = [filtering.update(Reading(0.5 * k, (90.0 if k > 4 else 1.0,))) for k in range(1, 12)]
    opened = [one.outcome for one in told].index("reopened")
    assert told[opened - 1].smoothed is not None
    assert [one.smoothed is None for one in told[opened:]][:3] == [True, True, False]


def test_a_filter_without_laws_back_has_no_lag():
    with pytest.raises(UserError, match="lag: expected a Gaussian filter, such as ukf or ekf; received enkf"):
        make(EnsembleKalmanFilter(ensemble=20), lag=1.0)


def test_modes_and_what_is_smoothed_are_columns(tmp_path):
    text = "t,q\n" + "".join(f"{0.5 * k},{1.0 + 0.1 * k}\n" for k in range(1, 9))

    def rows(filtering, **options):
        output = tmp_path / f"{'_'.join(options)}.csv"
        shape = Rows(SPACE.components, RULER, "csv", **options)
        Session(filtering, Lines(io.BytesIO(text.encode())), shape, str(output), None, 5).run()
        with output.open(newline="") as file:
            return list(csv.DictReader(file))

    found = rows(make(InteractingModels(filter=UnscentedKalmanFilter())), modes=2)
    sums = [float(row["mode_1"]) + float(row["mode_2"]) for row in found]
    assert sums == pytest.approx([1.0] * 8, rel=1e-12)
    found = rows(make(UnscentedKalmanFilter(), lag=1.0), lag=True)
    assert [row["lag_time"] for row in found[:3]] == ["", "0.0", "0.5"]
    assert float(found[5]["lag_sd_q"]) < float(found[3]["cov_q_q"]) ** 0.5
