"""Batch least squares that has not arrived says so."""

from __future__ import annotations

import torch
from helpers import close

from ahnn.estimation import Status, initial_belief
from ahnn.estimation import batch_least_squares as module
from ahnn.measurements import Position, State

F64 = torch.float64


def swing(x, dt):
    """A step of a pendulum, which leaves the numbers where it is too fast."""
    p = x[:, 1] - dt * x[:, 0].sin()
    return torch.where(x[:, 1:].abs() < 50.0, torch.stack((x[:, 0] + dt * p, p), -1), torch.nan)


def fit():
    truth = [torch.tensor([[1.0, 0.5], [-0.5, 1.0], [0.0, 90.0]], dtype=F64)]
    for _ in range(30):
        truth.append(swing(truth[-1], 0.2))
    rows = torch.stack(truth[1:], 1)[..., :1].nan_to_num()
    belief = initial_belief(truth[0] + torch.tensor([0.8, -0.6], dtype=F64), torch.eye(2, dtype=F64))
    return module.batch_least_squares(swing, belief, rows, Position(1), 1e-4 * torch.eye(1), 0.2)


def test_members_are_settled_sound_or_lost(monkeypatch):
    whole = fit()
    assert whole.status.tolist() == [Status.OK, Status.OK, Status.NOT_FINITE]
    assert whole.settled.tolist() == [True, True, False]
    monkeypatch.setattr(module, "ITERATIONS", 1)
    monkeypatch.setattr(module, "ROUGHLY", 0)
    begun = fit()
    assert begun.status.tolist() == [Status.OK, Status.OK, Status.NOT_FINITE]
    assert begun.settled.tolist() == [False] * 3
    assert bool((begun.cost > 2 * whole.cost)[:2].all())


def test_correlated_noise_of_partly_missing_measurements_is_that_of_the_measured_components():
    """Against generalised least squares for a body that coasts."""
    draw, dt, steps = torch.Generator().manual_seed(3), 0.3, 12
    noise = torch.tensor([[0.09, 0.012], [0.012, 0.0025]], dtype=F64)
    prior, mean = torch.diag(torch.tensor([4.0, 1.0], dtype=F64)), torch.tensor([0.5, 0.2], dtype=F64)
    rows = torch.randn(steps, 2, generator=draw, dtype=F64)
    rows[::3, 0], rows[1::3, 1] = torch.nan, torch.nan
    precision, pull = prior.inverse(), torch.zeros(2, dtype=F64)
    for k, row in enumerate(rows, 1):
        seen = ~row.isnan()
        moved = torch.tensor([[1.0, k * dt], [0.0, 1.0]], dtype=F64)[seen]
        weight = noise[seen][:, seen].inverse()
        precision = precision + moved.T @ weight @ moved
        pull = pull + moved.T @ weight @ (row[seen] - moved @ mean)
    coasting = torch.tensor([[1.0, dt], [0.0, 1.0]], dtype=F64)
    found = module.batch_least_squares(
        lambda x, _: x @ coasting.T, initial_belief(mean[None], prior), rows[None], State(1), noise, dt
    )
    close(found.initial.mean[0], mean + torch.linalg.solve(precision, pull), 1e-9)
    close(found.initial.chol[0] @ found.initial.chol[0].T, precision.inverse(), 1e-6)
