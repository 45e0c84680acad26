"""Fits of measurements that were drawn: the truth is found again to within what the fit says it knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import NOISE, TRUE, problem

from ahnn.errors import TrainingError
from ahnn.tracking.orbit_fit import orbit_fit
from ahnn.tracking.residual_noise import scatter_of
from ahnn.tracking.residual_table import coverage, pooled, residual_rows, table_lines, verdict

pytest.importorskip("erfa")
pytest.importorskip("de421")
NEAR = TRUE + np.array([30.0, -20, 10, 0.01, -0.02, 0.01])


def test_the_start_is_found_to_within_its_covariance():
    fit = orbit_fit(problem(start=NEAR)[0])
    off = fit.point.x - TRUE
    assert fit.converged
    assert off @ np.linalg.solve(fit.covariance, off) < 20  # chi squared of 6: 2.8 in a thousand
    assert np.abs(off[:3]).max() < 0.02
    sds = pooled(fit, fit.problem.used)
    assert sds["range"][1] == pytest.approx(NOISE[0], rel=0.12)
    assert all(verdict(row) == "fits" for row in residual_rows(fit, fit.problem.used))


def test_a_bias_is_estimated_or_named():
    with_bias, _ = problem(bias=0.5)
    fit = orbit_fit(with_bias)
    found, sd = fit.point.x[6:], fit.deviations[6:]
    assert (np.abs(found - 0.5) < 4 * sd).all()
    fixed = replace(with_bias.unknowns, deviations=np.where(np.arange(9) < 6, np.inf, 0.0))
    rows = residual_rows(orbit_fit(replace(with_bias, unknowns=fixed)), with_bias.used)
    words = " ".join(table_lines(rows))
    assert "scatter" in words or "a bias of" in words


def test_a_known_bias_of_the_wrong_sign_is_named():
    with_bias, _ = problem(bias=0.5)
    values = with_bias.model.data.values.copy()
    values[with_bias.model.data.station > 0, 0] -= 0.5  # of the first station alone
    model = with_bias.model.of(with_bias.model.stations, replace(with_bias.model.data, values=values))
    fixed = replace(
        with_bias.unknowns,
        mean=np.concatenate((TRUE, [-0.5, 0.0, 0.0])),
        deviations=np.array([np.inf] * 6 + [0.0] * 3),
    )
    fit = orbit_fit(replace(with_bias, unknowns=fixed, model=model))
    words = [verdict(row) for row in residual_rows(fit, with_bias.used) if row.kind == "range"]
    assert words[0].startswith("the given bias, -500 m, has the wrong sign")
    assert "sign" not in "".join(words[1:])


def test_outliers_are_not_followed_by_hubers_loss():
    wild, _ = problem(wild=10)
    squares, huber = orbit_fit(wild), orbit_fit(replace(wild, robust=True))
    assert np.linalg.norm((huber.point.x - TRUE)[:3]) < 0.3 * np.linalg.norm((squares.point.x - TRUE)[:3])


def test_noise_that_was_said_wrongly_is_estimated():
    wrong, _ = problem(noise_known=False)
    fit = orbit_fit(replace(wrong, noise=5 * wrong.noise, robust=True))
    assert fit.noise[0, :3] == pytest.approx(NOISE[:3], rel=0.12)


def test_a_push_is_learned_and_what_is_unseen_is_foretold():
    pushed, truth = problem(push=20.0, with_learned=True)
    used = np.arange(len(pushed.used)) < 160
    fit = orbit_fit(replace(pushed, used=used))
    basis = pushed.unknowns.smooth[0].basis
    t = np.linspace(1000, 13000, 9)
    size, design = basis.size, basis(t)
    block = slice(6 + size, 6 + 2 * size)
    found = design @ fit.point.x[block]
    sd = np.sqrt(np.einsum("tk,kl,tl->t", design, fit.covariance[block, block], design))
    off = np.abs(found - design @ truth[size : 2 * size])
    assert (off < 4 * sd).all()
    assert fit.smooth is not None
    assert 2 < fit.smooth.deviation < 200
    without = replace(
        pushed.unknowns, smooth=(), deviations=np.where(np.arange(len(truth) + 6) < 6, np.inf, 0.0)
    )
    other = orbit_fit(replace(pushed, used=used, unknowns=without, smooth=None))
    assert coverage(fit, ~used)["all"][1] > 0.85
    assert coverage(other, ~used)["range"][1] < 0.5


def test_a_start_that_is_none_is_refused_and_not_fitted():
    with pytest.raises(TrainingError, match="orbit: "):
        orbit_fit(problem(start=np.array([7000.0, 0, 0, 0, 0, 0]))[0])


def test_the_scatter_is_that_of_the_station_unless_it_measured_little():
    residuals, station = np.ones((30, 6)), np.repeat([0, 1, 1], 10)
    residuals[station == 1] = 3.0
    station[-2:] = 2
    found = scatter_of(residuals, station, np.ones(30, dtype=bool), np.full((3, 6), 9.0))
    assert found[:2, 0].tolist() == [1.0, 3.0]
    assert found[2, 0] == pytest.approx(np.sqrt((10 + 20 * 9) / 30))
