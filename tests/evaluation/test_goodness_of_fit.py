"""Measurements without truth: a right model leaves the noise alone, a wrong one shows."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import SPRING, Learned, make_case, trajectories
from torch import nn

from ahnn.data.segments import Segments
from ahnn.data.sensor import Sensor
from ahnn.evaluation.goodness_of_fit import explain, serial
from ahnn.evaluation.run import UNJUDGED, evaluate
from ahnn.integrators import INTEGRATORS


class Spring(nn.Module):
    """A spring by RK4, or another method."""

    def __init__(self, system, method="rk4"):
        super().__init__()
        self.field, self.method = system, INTEGRATORS[method]

    def increment(self, x, dt):
        return self.method.increment(self.field, x, dt)


def measured(count=40, noise=0.01, kind="position", **options):
    sensor = Sensor(SPRING.space, measured=kind, noise=noise, every=4, **options)
    segments = Segments(sensor.measure(trajectories(SPRING, count, 5), 0), None, sensor.instrument(SPRING.dt))
    return segments.gather(torch.arange(len(segments)))


def test_a_right_model_leaves_the_noise():
    found = explain(Spring(SPRING), measured())
    assert found.consistent
    assert found.band[0] < 1 < found.band[1]
    assert found.band[1] - found.band[0] == pytest.approx(4 * (2 / (40 * 29)) ** 0.5, rel=0.03)
    assert found.lost == 0
    assert "times the noise variance (0.92 to 1.08 if the model is right)" in found.sentence()


def test_a_wrong_model_leaves_more_and_what_it_leaves_is_not_white():
    stiffer = dataclasses.replace(SPRING, stiffness=5.6)
    found = explain(Spring(stiffer), measured())
    assert not found.consistent
    assert found.chi_square > found.band[1]
    assert found.correlation > found.correlation_band


def test_an_integrator_that_shows_beside_the_noise_is_named():
    batch = measured(noise=1e-3)
    found = explain(Spring(SPRING, "euler"), batch)
    assert found.chi_square > found.halved_steps > found.band[1]
    assert f"half the length {found.halved_steps:#.4g}" in found.sentence()
    exact = explain(Spring(SPRING), batch)
    assert exact.halved_steps == pytest.approx(exact.chi_square, rel=1e-6)
    assert "half the length" not in exact.sentence()


@pytest.mark.parametrize(("method", "order", "noise"), [("euler", 1, 1e-5), ("midpoint", 2, 1e-8)])
def test_an_integrator_that_fits_no_trajectory_is_named_and_a_wrong_model_is_not(method, order, noise):
    batch = measured(4, noise=noise)
    found = explain(Spring(SPRING, method), batch)
    assert found.lost == found.trajectories
    assert found.gain == pytest.approx(4**order, rel=0.2)  # errors are proportional to dt^order
    assert found.is_coarse
    assert f"residuals {found.gain**0.5:.2g} times smaller" in found.sentence()
    wrong = explain(Spring(dataclasses.replace(SPRING, stiffness=5.6)), measured(4, noise=1e-4))
    assert wrong.lost == wrong.trajectories
    assert wrong.gain == pytest.approx(1.0, rel=1e-3)
    assert not wrong.is_coarse
    assert "half the length" not in wrong.sentence()


@pytest.mark.parametrize("robust", ["huber", "student"])
def test_outliers_are_left_out_where_the_training_weighed_them_down(robust):
    batch = measured(outliers=0.05)
    found = explain(Spring(SPRING), batch, robust)
    assert found.consistent
    assert found.outliers == pytest.approx(0.05, abs=0.02)
    assert "excluded as outliers" in found.sentence()
    assert found.numbers()["outliers"] == found.outliers
    assert explain(Spring(SPRING), batch).lost > 0.6 * len(batch.values)
    assert explain(Spring(SPRING), measured()).outliers == 0


def test_gaps_are_no_residuals_and_what_is_not_met_is_counted():
    batch = measured(gaps=0.3)
    found = explain(Spring(SPRING), batch)
    assert found.consistent
    values = batch.values.clone()
    values[2] += 10 * torch.arange(values.shape[1]).sin().unsqueeze(-1)
    spoilt = explain(Spring(SPRING), batch._replace(values=values))
    assert (spoilt.lost, spoilt.trajectories) == (1, len(values))
    assert not spoilt.is_partial
    assert spoilt._replace(lost=len(values) // 2).is_partial
    assert not spoilt.consistent
    assert "not fitted" in spoilt.sentence()


def test_nothing_explained_is_said_in_words():
    batch = measured(count=3)
    found = explain(
        Spring(SPRING), batch._replace(values=1e9 * torch.randn(batch.values.shape, dtype=torch.float64))
    )
    assert found.lost == 3
    assert found.sentence() == "no initial state fits the measurements of any of 3 unseen trajectories"


def test_serial_correlation():
    noise = torch.randn(200, 500, 1, generator=torch.Generator().manual_seed(0))
    moved = (noise[:, 1:] + 0.5 * noise[:, :-1]) / 1.25**0.5
    found, pairs = serial(moved)
    assert found == pytest.approx(0.4, abs=0.01)
    assert pairs == 200 * 498


@pytest.mark.parametrize("robust", ["none", "student"])
def test_noise_is_not_judged_by_a_model_that_does_not_fit_half_of_the_trajectories(tmp_path, robust):
    """Without a robust loss outliers may be the cause, and are named."""
    batch = measured(count=12)
    values = batch.values.clone()
    values[::2] += 10 * torch.arange(values.shape[1]).sin().unsqueeze(-1)
    case = make_case(tmp_path, measured=batch._replace(values=values), flow=Learned(SPRING.stiffness))
    found = evaluate(dataclasses.replace(case, robust=robust), {}, figures=False).numbers
    assert found["measurements"]["lost"] >= 3
    assert (UNJUDGED in found["verdict"]["findings"]) == (robust == "student")
