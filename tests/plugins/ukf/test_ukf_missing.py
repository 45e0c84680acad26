"""What was not measured: whole rows, components, and one scalar once."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import Belief, initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, members, unscented_filter

FORMS = [SQUARE_ROOT, STANDARD]
F64 = torch.float64


class Reduced:
    """Some of the components of another model."""

    def __init__(self, model, keep):
        self.model, self.keep = model, keep
        self.names = tuple(model.names[i] for i in keep)
        self.units = tuple(model.units[i] for i in keep)

    def __call__(self, x, t):
        return self.model(x, t)[..., self.keep]

    def residual(self, y, y_pred):
        return y - y_pred


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_missing_component_equals_the_reduced_measurement(make_linear, close, form, monkeypatch):
    problem, model = make_linear(5, 3, steps=60, batch=2, seed=3)
    rows = problem.measurements.clone()
    rows[:, :, 1] = torch.nan
    belief = initial_belief(problem.mean, problem.p0)
    arguments = (belief, rows, model, problem.q, problem.r, 1.0)
    full = unscented_filter(problem.flow, *arguments, form=form)
    keep = [0, 2]
    reduced = unscented_filter(
        problem.flow,
        belief,
        rows[..., keep],
        Reduced(model, keep),
        problem.q,
        problem.r[keep][:, keep],
        1.0,
        form=form,
    )
    assert close(full.means, reduced.means, 1e-12)
    assert close(full.covariances, reduced.covariances, 1e-12, trailing=2)
    assert torch.allclose(full.nis, reduced.nis, rtol=1e-11, atol=0.0)
    assert torch.allclose(full.log_likelihood, reduced.log_likelihood, rtol=1e-12, atol=0.0)
    assert bool(torch.isnan(full.innovations[..., 1]).all())
    assert full.measured.unique().tolist() == [2]
    monkeypatch.setattr(members, "library", lambda: None)
    drawn = (belief, rows, Reduced(model, [0, 1, 2]), *arguments[3:])  # with sigma points of the measurement
    without = unscented_filter(problem.flow, *drawn, form=form)
    assert close(without.means, full.means, 1e-12)
    assert close(without.covariances, full.covariances, 1e-12, trailing=2)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_one_scalar_missing_once_equals_the_reduced_measurement_at_that_time(make_linear, close, form):
    problem, model = make_linear(4, 2, steps=50, batch=3, seed=5)
    rows = problem.measurements.clone()
    rows[1, 20, 0] = torch.nan

    def run(belief, rows, model, r):
        return unscented_filter(problem.flow, belief, rows, model, problem.q, r, 1.0, form=form)

    full = run(initial_belief(problem.mean, problem.p0), rows, model, problem.r)
    before = Belief(full.means[1:2, 19], full.chols[1:2, 19])
    reduced = run(before, rows[1:2, 20:21, 1:], Reduced(model, [1]), problem.r[1:, 1:])
    after = run(Belief(reduced.means[:, 0], reduced.chols[:, 0]), rows[1:2, 21:], model, problem.r)
    assert full.measured[1, 20] == 1
    for expected, steps in ((reduced, slice(20, 21)), (after, slice(21, None))):
        assert close(full.means[1:2, steps], expected.means, 1e-12)
        assert close(full.covariances[1:2, steps], expected.covariances, 1e-12, trailing=2)
        assert torch.allclose(full.nis[1:2, steps], expected.nis, rtol=1e-11, atol=0.0)


def test_a_row_of_nan_is_no_update(make_linear):
    problem, model = make_linear(4, 2, steps=30, batch=3, seed=6)
    rows = problem.measurements.clone()
    rows[1, 10] = torch.nan
    rows[:, 20] = torch.nan
    belief = initial_belief(problem.mean, problem.p0)
    result = unscented_filter(problem.flow, belief, rows, model, problem.q, problem.r, 1.0)
    for b, k in [(1, 10), (0, 20), (1, 20), (2, 20)]:
        assert torch.equal(result.means[b, k], result.predicted_means[b, k])
        assert torch.equal(result.chols[b, k], result.predicted_chols[b, k])
        assert math.isnan(result.nis[b, k])
    assert not torch.equal(result.means[0, 10], result.predicted_means[0, 10])


def test_nothing_measured_calls_the_model_never():
    class Untouchable(Position):
        def __call__(self, x, t):
            raise AssertionError(x, t)

    result = unscented_filter(
        lambda x, dt: x + dt * x.flip(-1),
        initial_belief(torch.ones(2, 2, dtype=F64), 0.01 * torch.eye(2)),
        torch.full((2, 7, 1), torch.nan, dtype=F64),
        Untouchable(1),
        1e-5 * torch.eye(2),
        torch.eye(1),
        0.05,
    )
    assert torch.equal(result.means, result.predicted_means)
