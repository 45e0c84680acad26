"""Long runs with ill-conditioned covariances, and the repairs of the form that cannot hold them."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import Belief, initial_belief
from ahnn.estimation.linalg import tria
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter

F64 = torch.float64


@pytest.mark.parametrize("steps", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_ill_conditioned_covariances_need_no_repair(steps):
    # Two directions are known to 3e-3 and two to 4e4, none of them an axis: the condition number of the
    # covariance passes 1e14, and every entry of it cancels. The same problem along the axes is the oracle.
    generator = torch.Generator().manual_seed(0)
    scale = torch.tensor([4e4, 4e4, 1.0, 1.0], dtype=F64)
    turn = torch.tensor([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]], dtype=F64)
    rotation = torch.block_diag(turn, turn)
    rows = 0.1 * torch.randn(1, steps, 2, generator=generator, dtype=F64)
    rows[:, ::2, 1] = torch.nan

    class Precise(Position):
        def __init__(self, axes):
            super().__init__(2)
            self.axes = axes

        def __call__(self, x, t):
            del t
            return (x.unsqueeze(-2) * self.axes.mT[2:]).sum(-1)

    def run(axes):
        step = axes @ rotation @ axes.mT
        belief = Belief(torch.zeros(1, 4, dtype=F64), tria((axes * scale).mT[None]))
        noise = 1e-8 * torch.eye(4), 1e-2 * torch.eye(2)
        return unscented_filter(lambda x, _: x @ step.mT, belief, rows, Precise(axes), *noise, 1.0)

    axes = torch.linalg.qr(torch.randn(4, 4, generator=generator, dtype=F64)).Q
    result, expected = run(axes), run(torch.eye(4, dtype=F64))
    condition = torch.linalg.cond(result.chols[0, ::100]).square()
    assert float(condition.max()) > 1e14
    assert result.status.tolist() == result.repairs.tolist() == [0]
    deviation = expected.covariances[0, -1].diagonal().sqrt()
    error = axes.mT @ result.chols[0, -1]
    error = error @ error.mT - expected.covariances[0, -1]
    assert float((error / torch.outer(deviation, deviation)).abs().max()) < 1e-4


def folded(x, _):
    """Map the unit sphere so that weights with beta < -1 see a negative variance along (1, -1)."""
    a, b = x.unbind(-1)
    return torch.stack((a + b * b, a - b * b), dim=-1)


@pytest.mark.parametrize("form", [STANDARD, SQUARE_ROOT], ids=lambda form: form.name)
@pytest.mark.parametrize(("beta", "repairs"), [(-1.5, 1), (-0.5, 0)])
def test_a_covariance_that_the_weights_make_indefinite_is_counted(form, beta, repairs):
    # With alpha = 1 and kappa = 0 the covariance is [[1, 1], [1, 1]] + (1 + beta) [[1, -1], [-1, 1]]: both
    # variances are positive, the eigenvalue along (1, -1) is so for beta > -1 alone.
    belief = initial_belief(torch.zeros(1, 2, dtype=F64), torch.eye(2))
    noise = 1e-6 * torch.eye(2), torch.eye(1)
    parameters = UnscentedParameters(1.0, beta, 0.0)
    rows = torch.full((1, 1, 1), torch.nan, dtype=F64)
    result = unscented_filter(
        folded, belief, rows, Position(1), *noise, 1.0, parameters=parameters, form=form
    )
    assert result.status.tolist() == [0]
    assert result.repairs.tolist() == [repairs]


def pendulum(x, dt):
    p = x[:, 1] - dt * torch.sin(x[:, 0])
    return torch.stack((x[:, 0] + dt * p, p), dim=-1)


def test_tiny_measurement_noise_stays_positive():
    steps = 2000
    rows = torch.sin(0.05 * torch.arange(steps, dtype=F64)).reshape(1, steps, 1)
    belief = initial_belief(torch.ones(1, 2, dtype=F64), torch.eye(2))
    result = unscented_filter(
        pendulum, belief, rows, Position(1), 1e-6 * torch.eye(2), 1e-12 * torch.eye(1), 0.05
    )
    assert result.status.tolist() == result.repairs.tolist() == [0]
    assert bool((torch.linalg.eigvalsh(result.covariances) >= 0.0).all())
