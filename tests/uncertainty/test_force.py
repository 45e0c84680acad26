"""The deviation of a learned force: closed forms of an oscillator, and directions that are left out."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing

from ahnn.uncertainty import force_deviation

FACTOR = torch.tensor([[2e-3, 0.0], [-1e-3, 3e-3]], **DOUBLE)


def states(count=40):
    return torch.randn(count, 2, generator=generator(4), **DOUBLE)


def exact(x, a=2.0, b=0.5):
    """dF/da = -q, dF/db = -q^3 in F = -a q - b q^3."""
    q = x[..., 0]
    moved = torch.stack((-q, -(q**3)), dim=-1) @ FACTOR
    return moved.norm(dim=-1) / (a * q + b * q**3).abs()


def test_the_deviation_of_an_oscillator_is_that_of_its_two_parameters():
    x = states().unflatten(0, (8, 5))
    close(force_deviation(Swing(), FACTOR, states())(x), exact(x), 2e-4)


def test_directions_that_do_not_move_the_force_cost_nothing():
    widened = torch.cat((FACTOR, torch.zeros(2, 30, **DOUBLE)), dim=1)
    close(force_deviation(Swing(), widened, states())(states()), exact(states()), 2e-4)


@pytest.mark.parametrize("factor", [FACTOR, torch.zeros_like(FACTOR)])
def test_where_there_is_no_force_the_fraction_is_finite(factor):
    assert bool(force_deviation(Swing(), factor, states())(torch.zeros(3, 2, **DOUBLE)).isfinite().all())
