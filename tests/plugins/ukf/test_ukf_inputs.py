"""Mistakes of users, the times of measurements, and the linear algebra below."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import STANDARD, UnscentedParameters, unscented_filter

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
    with pytest.raises(
        ValueError, match=rf"{name}: expected a symmetric matrix; received \[0, 1\] = 0.5 but"
    ):
        run(**{key: ASYMMETRIC})
    with pytest.raises(ValueError, match=f"{name}: expected no negative eigenvalue; received -1;"):
        run(**{key: INDEFINITE})
    with pytest.raises(ValueError, match=f"{name}: expected finite entries"):
        run(**{key: EYE * math.nan})
    with pytest.raises(
        ValueError, match=rf"{name}: expected shape \(2, 2\) or \(2, 2, 2\); received \(3, 3\)"
    ):
        run(**{key: torch.eye(3)})
    with pytest.raises(ValueError, match=f"{name}: .* received -1 of member 1"):
        run(**{key: torch.stack((EYE, INDEFINITE))})


def test_measurement_noise_is_checked_too():
    with pytest.raises(ValueError, match=r"R: expected no negative variance; received \[0, 0\] = -1"):
        run(r=-EYE[:1, :1])
    with pytest.raises(ValueError, match="R: expected a positive definite matrix; received eigenvalue 0;"):
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
        ValueError, match=f"L \\+ lambda .* received .* alpha = {alpha:g}, kappa = {kappa:g}, L = 2"
    ):
        run(parameters=UnscentedParameters(alpha, 2.0, kappa))


def test_shapes_and_values_at_the_door():
    with pytest.raises(ValueError, match=r"measurements: expected shape \(2, T, 1\)"):
        run(rows=torch.zeros(3, 4, 1, dtype=F64))
    rows = torch.zeros(2, 4, 1, dtype=F64)
    rows[1, 2] = math.inf
    with pytest.raises(ValueError, match=r"infinite one at \[1, 2, 0\]"):
        run(rows=rows)
    with pytest.raises(ValueError, match=r"dt: expected a number or shape \(4,\)"):
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
