"""Batch least squares that has not arrived says so."""

from __future__ import annotations

import torch

from ahnn.estimation import Status, initial_belief
from ahnn.estimation import batch_least_squares as module
from ahnn.measurements import Position

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
