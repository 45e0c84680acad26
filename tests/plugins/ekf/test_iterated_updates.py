"""Iterated updates: the most probable state, which scipy finds too, and nothing new on lines."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sample_filters import linear_problem
from scipy.optimize import minimize

from ahnn.estimation import initial_belief
from ahnn_plugins.ekf import ExtendedKalmanFilter

P0 = np.array([[0.5, 0.1], [0.1, 0.3]])
START = np.array([[1.0, 0.5], [0.8, -0.6]])


class Polar:
    names, units = ("range", "angle"), ("m", "rad")

    def __call__(self, x, t):
        return torch.stack((x.norm(dim=-1), torch.atan2(x[..., 1], x[..., 0])), -1)


SD = np.array([0.01, 0.02])
ROW = np.array([[1.9, 1.2], [0.4, -1.6]])


def most_probable(mean, row):
    def cost(x):
        seen = np.array([np.hypot(*x), np.arctan2(x[1], x[0])])
        off = (row - seen) / SD
        there = ~np.isnan(off)
        return off[there] @ off[there] + (x - mean) @ np.linalg.solve(P0, x - mean)

    begin = np.array([row[0] * np.cos(row[1]), row[0] * np.sin(row[1])])
    return minimize(cost, begin, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12}).x


def test_they_go_to_the_most_probable_state():
    belief = initial_belief(START, P0)
    found = {}
    for count in (1, 12):
        ekf = ExtendedKalmanFilter(iterations=count)
        found[count], told = ekf.update(ekf.start(belief), ROW, Polar(), np.diag(SD**2))
        if count == 1:
            once = told
    exact = np.stack([most_probable(mean, row) for mean, row in zip(START, ROW, strict=True)])
    np.testing.assert_allclose(found[12].belief.mean, exact, atol=1e-7)
    assert float((found[1].belief.mean - torch.from_numpy(exact)).abs().max()) > 0.1
    for name in ("residual", "nis", "log_likelihood"):  # by the prediction
        torch.testing.assert_close(getattr(told, name), getattr(once, name))


def test_a_missing_number_stays_missing():
    row = ROW.copy()
    row[:, 1] = np.nan

    class Range(Polar):
        names, units = ("range",), ("m",)

        def __call__(self, x, t):
            return super().__call__(x, t)[..., :1]

    ekf = ExtendedKalmanFilter(iterations=6)
    state = ekf.start(initial_belief(START, P0))
    with_gap, _ = ekf.update(state, row, Polar(), np.diag(SD**2))
    alone, _ = ekf.update(state, row[:, :1], Range(), SD[:1, None] ** 2)
    torch.testing.assert_close(with_gap.belief.mean, alone.belief.mean, rtol=1e-10, atol=1e-12)


def test_on_a_line_they_change_nothing():
    problem = linear_problem(0.1)
    once, often = (ExtendedKalmanFilter(iterations=k).run(*problem) for k in (1, 3))
    torch.testing.assert_close(often.means, once.means, rtol=1e-11, atol=1e-12)
    torch.testing.assert_close(often.covariances, once.covariances, rtol=1e-11, atol=1e-12)


def test_no_iteration_is_refused():
    with pytest.raises(ValueError, match="iterations: expected a whole number >= 1; received 0"):
        ExtendedKalmanFilter(iterations=0)
