"""Covariances as users give them, and the linear algebra of their factors."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import initial_belief
from ahnn.estimation.covariances import covariance_factor
from ahnn.estimation.linalg import cholesky_repaired, downdate, tria

F64 = torch.float64
EYE = torch.eye(2, dtype=F64)
INDEFINITE = torch.tensor([[1.0, 2.0], [2.0, 1.0]], dtype=F64)


def test_tria_and_downdate_are_inverse_to_adding_a_row():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(3, 9, 5, generator=generator, dtype=F64)
    chol = tria(rows)
    assert torch.allclose(chol @ chol.mT, rows.mT @ rows, rtol=1e-13)
    assert torch.equal(chol, chol.tril())
    assert bool((torch.diagonal(chol, dim1=1, dim2=2) >= 0.0).all())
    lowered, possible = downdate(chol, rows[:, 0])
    assert torch.allclose(lowered @ lowered.mT, rows[:, 1:].mT @ rows[:, 1:], rtol=1e-12, atol=1e-12)
    assert possible.tolist() == [True] * 3
    kept, possible = downdate(chol, rows[:, 0] * torch.tensor([1.0, 1e3, 1.0])[:, None])
    assert possible.tolist() == [True, False, True]
    assert torch.equal(kept[1], chol[1])


def test_repairs_touch_only_what_needs_them():
    matrices = torch.stack((EYE, INDEFINITE, EYE * math.nan, -EYE))
    chol, repaired = cholesky_repaired(matrices)
    assert repaired.tolist() == [False, True, False, False]
    assert torch.equal(chol[0], EYE)
    assert torch.allclose((chol[1] @ chol[1].mT), torch.full((2, 2), 1.5, dtype=F64), rtol=1e-12)
    assert bool(torch.isnan(chol[2]).all())
    assert torch.equal(chol[3], torch.zeros(2, 2, dtype=F64))


def test_badly_scaled_covariances_are_accepted():
    scale = torch.tensor([1e8, 1e-8], dtype=F64)
    matrix = torch.outer(scale, scale) * torch.tensor([[1.0, 0.9], [0.9, 1.0]], dtype=F64)
    chol = covariance_factor(matrix, "P0", batch=1, size=2, definite=True)
    assert torch.allclose(chol @ chol.mT, matrix, rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("sizes", [(1e3, 1e-3), (1e-3, 1e3), (2.0, 3.0)])
def test_components_that_move_together_have_a_factor_in_any_units(sizes):
    matrix = torch.outer(torch.tensor(sizes, dtype=F64), torch.tensor(sizes, dtype=F64))
    chol = covariance_factor(matrix, "P0", batch=1, size=2, definite=False)
    assert torch.allclose(chol @ chol.mT, matrix, rtol=1e-7, atol=0.0)
    with pytest.raises(ValueError, match="expected a positive definite matrix"):
        covariance_factor(matrix, "P0", batch=1, size=2, definite=True)
    more = matrix * torch.tensor([[1.0, 1.001], [1.001, 1.0]], dtype=F64)
    for definite in (True, False):
        with pytest.raises(ValueError, match="expected no negative eigenvalue"):
            covariance_factor(more, "P0", batch=1, size=2, definite=definite)


def test_mistakes_of_the_initial_belief():
    with pytest.raises(ValueError, match=r"P0: expected shape \(2, 2\) or \(1, 2, 2\); received \(\)"):
        initial_belief([[0.0, 0.0]], 1.0)
    with pytest.raises(ValueError, match=r"initial_belief: mean: expected numbers .* received str"):
        initial_belief("zero", EYE)
    with pytest.raises(ValueError, match=r"expected a mean of shape \(B, D\) with B >= 1; received \(0, 2\)"):
        initial_belief(torch.zeros(0, 2), EYE)


def test_gradients_flow_past_components_without_variance() -> None:
    variance = torch.tensor([2.0, 3.0], dtype=torch.float64, requires_grad=True)
    matrix = torch.diag_embed(torch.cat((torch.zeros(2), variance, torch.zeros(1))))
    chol = covariance_factor(matrix, "Q", batch=1, size=5, definite=False)
    assert torch.allclose(chol @ chol.mT, matrix, rtol=1e-15)
    (gradient,) = torch.autograd.grad(chol.sum(), variance)
    assert gradient.tolist() == pytest.approx([0.5 / 2**0.5, 0.5 / 3**0.5], rel=1e-12)
