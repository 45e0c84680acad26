"""Covariances that stop being covariances: what is mended, counted once, and what ends a member."""

from __future__ import annotations

import pytest
import torch

from ahnn.estimation import Belief, Status, initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter
from ahnn_plugins.ukf.sigma_points import unscented_weights

FORMS = [SQUARE_ROOT, STANDARD]
F64 = torch.float64
EYE = torch.eye(2, dtype=F64)
NOTHING = torch.full((2, 1, 1), torch.nan, dtype=F64)

NEGATIVE = UnscentedParameters(1.0, 0.0, torch.tensor([-1.5, 1.0]))
"""Of two members, the first has a weight so negative that a covariance may be indefinite."""


def predict_once(flow, form, **options):
    belief = initial_belief(torch.zeros(2, 2, dtype=F64), EYE)
    q, r = 0.01 * EYE, EYE[:1, :1]
    return unscented_filter(
        flow, belief, NOTHING, Position(1), q, r, 1.0, parameters=NEGATIVE, form=form, **options
    )


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_predicted_variance_below_zero_is_a_collapse(form):
    # f(x) = x²: the weighted variance of the image is W r⁴ - (2 W r²)² / 4 < 0.
    result = predict_once(lambda x, _: x**2, form)
    assert result.status.tolist() == [Status.COLLAPSED, Status.OK]
    assert result.repairs.tolist() == [0, 0]


@pytest.mark.parametrize("smoothing", [False, True])
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_an_indefinite_prediction_is_one_counted_repair(form, smoothing):
    # f(x) = x + x²: covariance [[0.5, -1], [-1, 0.5]], variances positive.
    result = predict_once(lambda x, _: x + x**2, form, smoothing=smoothing)
    assert result.status.tolist() == [Status.OK, Status.OK]
    assert result.repairs.tolist() == [1, 0]
    assert bool(torch.isfinite(result.chols).all())


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_measured_variance_below_zero_is_a_collapse(form):
    class Square(Position):
        def __call__(self, x, t):
            return super().__call__(x, t) ** 2

    belief = initial_belief(torch.zeros(2, 2, dtype=F64), EYE)
    rows = torch.zeros(2, 1, 1, dtype=F64)
    result = unscented_filter(
        lambda x, _: 1.0 * x,
        belief,
        rows,
        Square(1),
        0.01 * EYE,
        0.01 * EYE[:1, :1],
        1.0,
        parameters=UnscentedParameters(1.0, -1.0, torch.tensor([-1.5, 1.0])),
        form=form,
    )
    assert result.status.tolist() == [Status.COLLAPSED, Status.OK]
    assert result.repairs.tolist() == [0, 0]


def test_the_standard_form_says_when_it_loses_a_covariance():
    # 1e16 - 1e16 + 1e-4 rounds to zero or less.
    def run(variance, form):
        rows = torch.ones(2, 3, 1, dtype=F64)
        belief = initial_belief(torch.zeros(2, 2), torch.stack((variance * EYE, EYE)))
        r = 1e-4 * EYE[:1, :1]
        return unscented_filter(
            lambda x, _: 1.0 * x, belief, rows, Position(1), 1e-6 * EYE, r, 1.0, form=form
        )

    lost, exact, clean = run(1e16, STANDARD), run(1e16, SQUARE_ROOT), run(1.0, STANDARD)
    assert lost.status.tolist() == [Status.COLLAPSED, Status.OK]
    assert lost.failed_step.tolist() == [0, -1]
    assert bool(torch.isnan(lost.means[0]).all())
    assert torch.equal(lost.chols[1], clean.chols[1])
    assert exact.status.tolist() == exact.repairs.tolist() == [0, 0]
    assert exact.covariances[0, 0].diagonal().tolist() == pytest.approx([1e-4, 1e16], rel=1e-6)


def test_two_repairs_in_one_update_are_two():
    # Even images correlate with nothing: P_yy = [[0.5, -1], [-1, 0.5]], and the prior, which is singular,
    # remains.
    prior = Belief(torch.zeros(1, 2, dtype=F64), torch.tensor([[[1.0, 0.0], [1.0, 1e-9]]], dtype=F64))
    images = torch.tensor([[[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.0], [0.0, 0.5]]], dtype=F64)
    weights = unscented_weights(UnscentedParameters(1.0, 0.0, -1.5), 2)
    y = torch.zeros(1, 2, dtype=F64)
    updated = STANDARD.update(prior, images, y, Position(2).residual, weights, EYE[None])
    assert updated.repairs is not None
    assert updated.repairs.tolist() == [2]
    assert updated.singular.tolist() == [False]
