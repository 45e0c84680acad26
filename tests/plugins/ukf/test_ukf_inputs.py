"""Mistakes of users, the times of measurements, and the linear algebra below."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation.covariances import covariance_factor
from ahnn.estimation.linalg import cholesky_repaired, downdate, tria
from ahnn_plugins.ukf import (
    STANDARD,
    Gate,
    Position,
    UnscentedParameters,
    every,
    initial_belief,
    schedule,
    unscented_filter,
)

F64 = torch.float64
EYE = torch.eye(2, dtype=F64)


def run(mean=None, p0=EYE, q=0.1 * EYE, r=EYE[:1, :1], rows=None, dt=1.0, flow=None, **options):
    mean = torch.zeros(2, 2, dtype=F64) if mean is None else mean
    rows = torch.zeros(2, 4, 1, dtype=F64) if rows is None else rows
    flow = (lambda x, _: x * 1.0) if flow is None else flow
    return unscented_filter(flow, initial_belief(mean, p0), rows, Position(1), q, r, dt, **options)


ASYMMETRIC = torch.tensor([[1.0, 0.5], [0.4, 1.0]], dtype=F64)
INDEFINITE = torch.tensor([[1.0, 2.0], [2.0, 1.0]], dtype=F64)


@pytest.mark.parametrize("name", ["P0", "Q"])
def test_matrices_that_are_not_covariances_are_named(name):
    key = name.lower()
    with pytest.raises(ValueError, match=rf"{name}: expected a symmetric matrix, got \[0, 1\] = 0.5 but"):
        run(**{key: ASYMMETRIC})
    with pytest.raises(ValueError, match=f"{name}: expected no negative eigenvalue, got -1;"):
        run(**{key: INDEFINITE})
    with pytest.raises(ValueError, match=f"{name}: expected finite entries"):
        run(**{key: EYE * math.nan})
    with pytest.raises(ValueError, match=rf"{name}: expected shape \(2, 2\) or \(2, 2, 2\), got \(3, 3\)"):
        run(**{key: torch.eye(3)})
    with pytest.raises(ValueError, match=f"{name}: .* got -1 of member 1"):
        run(**{key: torch.stack((EYE, INDEFINITE))})


def test_measurement_noise_is_checked_too():
    with pytest.raises(ValueError, match=r"R: expected no negative variance, got \[0, 0\] = -1"):
        run(r=-EYE[:1, :1])
    with pytest.raises(ValueError, match="R: expected a positive definite matrix, got eigenvalue 0;"):
        run(r=0.0 * EYE[:1, :1], form=STANDARD)
    result = run(r=0.0 * EYE[:1, :1])
    assert result.status.tolist() == [0, 0]
    assert float(result.means[..., 0].abs().max()) == 0.0


def test_a_singular_start_is_refused_and_a_singular_process_noise_is_not():
    singular = torch.tensor([[1.0, 1.0], [1.0, 1.0]], dtype=F64)
    with pytest.raises(ValueError, match="P0: expected a positive definite matrix"):
        run(p0=singular)
    result = run(q=singular)
    assert torch.allclose(result.predicted_chols[0, 0] @ result.predicted_chols[0, 0].mT, EYE + singular)


@pytest.mark.parametrize(("alpha", "kappa"), [(0.0, 0.0), (1.0, -2.0), (0.5, -3.0)])
def test_parameters_without_sigma_points(alpha, kappa):
    with pytest.raises(
        ValueError, match=f"L \\+ lambda .* got .* alpha = {alpha:g}, kappa = {kappa:g}, L = 2"
    ):
        run(parameters=UnscentedParameters(alpha, 2.0, kappa))


def test_shapes_and_values_at_the_door():
    with pytest.raises(ValueError, match=r"measurements \(2, T, 1\)"):
        run(rows=torch.zeros(3, 4, 1, dtype=F64))
    rows = torch.zeros(2, 4, 1, dtype=F64)
    rows[1, 2] = math.inf
    with pytest.raises(ValueError, match=r"infinite one at \[1, 2, 0\]"):
        run(rows=rows)
    with pytest.raises(ValueError, match=r"dt a number or of shape \(4,\)"):
        run(dt=torch.ones(3))
    with pytest.raises(ValueError, match="member 1 is not finite"):
        run(mean=torch.tensor([[0.0, 0.0], [math.nan, 0.0]], dtype=F64))
    with pytest.raises(ValueError, match="the shape of x"):
        run(flow=lambda x, _: x[:1])
    with pytest.raises(ValueError, match="probability in"):
        run(gate=Gate(probability=1.0))
    with pytest.raises(ValueError, match=r"mean of shape \(B, D\)"):
        initial_belief(torch.zeros(2), EYE)


def test_irregular_steps_and_times_reach_flow_model_and_noise():
    seen = {"flow": [], "model": [], "noise": []}

    class Clocked(Position):
        def __call__(self, x, t):
            seen["model"].append(t)
            return super().__call__(x, t)

    def flow(x, dt):
        seen["flow"].append(dt)
        return x * 1.0

    def noise(dt):
        seen["noise"].append(dt)
        return 0.1 * dt * EYE

    dt = torch.tensor([1.0, 2.0, 1.0, 4.0], dtype=F64)
    rows = torch.zeros(2, 4, 1, dtype=F64)
    rows[:, 1] = math.nan
    belief = initial_belief(torch.zeros(2, 2, dtype=F64), EYE)
    result = unscented_filter(flow, belief, rows, Clocked(1), noise, EYE[:1, :1], dt, start_time=10.0)
    assert seen["flow"] == [1.0, 2.0, 1.0, 4.0]
    assert seen["noise"] == [1.0, 2.0, 4.0]
    assert seen["model"] == [11.0, 14.0, 18.0]
    # The unmeasured momentum only gathers noise.
    assert float(result.covariances[0, -1, 1, 1]) == pytest.approx(1.8, rel=1e-12)


def test_every_kth_step():
    rows = every(torch.ones(2, 7, 1), 3)
    assert torch.isfinite(rows[0, :, 0]).nonzero().flatten().tolist() == [2, 5]
    with pytest.raises(ValueError, match="got 0"):
        every(rows, 0)


def test_schedule_hits_every_measurement():
    times = torch.tensor([2.0, 2.5, 60.0 + 1e-14, 120.0], dtype=F64)
    values = torch.arange(4.0, dtype=F64).reshape(1, 4, 1)
    dt, rows = schedule(times, values, max_step=30.0, start_time=1.0)
    ends = 1.0 + dt.cumsum(0)
    present = torch.isfinite(rows[0, :, 0])
    assert torch.allclose(ends[present], times, rtol=1e-14)
    assert torch.equal(rows[0, present], values[0])
    assert float(dt.max()) <= 30.0 * (1.0 + 1e-9)
    assert dt.tolist() == [1.0, 0.5, *[pytest.approx(28.75)] * 2, *[pytest.approx(30.0)] * 2]
    with pytest.raises(ValueError, match="increasing"):
        schedule(times.flip(0), values, 30.0)
    with pytest.raises(ValueError, match=r"measurements \(B, K, M\), got \(3,\) and"):
        schedule(times[:3], values, 30.0)


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
