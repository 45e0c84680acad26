"""When the sweeps of gl4 stop: at the tolerance, or where only rounding is left to change."""

from __future__ import annotations

import pytest
import torch
from helpers import SYSTEMS, close, random_states

from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4
from ahnn.integrators.implicit import _of_block

EPS = torch.finfo(torch.float64).eps


class Flicker:
    """A field that changes by the same amount in each sweep, as rounding may."""

    def __init__(self, amount):
        self.amount, self.calls = amount, 0

    def __call__(self, x):
        sweep = (self.calls + 1) // 2  # one call before the sweeps, two in each
        self.calls += 1
        return torch.full_like(x, self.amount * (sweep % 2))


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6, -1e6])
def test_a_change_at_the_level_of_rounding_ends_the_sweeps(size):
    x, scale = torch.full((1, 2), size, dtype=torch.float64), abs(size)
    method = GaussLegendre4(tolerance=1e-30)
    for step in (0.5, -0.5):
        field = Flicker(20 * EPS * scale / abs(step))
        method.increment(field, x, step)
        assert field.calls == 5  # two sweeps: the second changes no less than the first
        with pytest.raises(UserError, match="did not converge"):
            method.increment(Flicker(400 * EPS * scale / abs(step)), x, step)


@pytest.mark.parametrize(("size", "allowed"), [(1e-6, 1e-9), (100.0, 0.1)])
def test_a_change_within_the_tolerance_of_the_state_ends_the_sweeps(size, allowed):
    x = torch.full((1, 2), size, dtype=torch.float64)
    for share, calls in ((0.9, 3), (1.1, None)):
        field = Flicker(share * allowed / 0.5)
        if calls is None:
            with pytest.raises(UserError, match="did not converge"):
                GaussLegendre4(tolerance=1e-3).increment(field, x, 0.5)
            continue
        GaussLegendre4(tolerance=1e-3).increment(field, x, 0.5)
        assert field.calls == calls


def test_a_looser_tolerance_costs_accuracy_in_proportion():
    system = SYSTEMS["kepler"]
    x = random_states(system, 5, seed=1)
    exact = GaussLegendre4().increment(system, x, 0.1)
    for tolerance in (1e-3, 1e-6, 1e-9):
        close(GaussLegendre4(tolerance=tolerance).increment(system, x, 0.1), exact, 10 * tolerance)


@pytest.mark.parametrize("power", [-120, -40, 0, 40, 120])
def test_steps_do_not_know_the_units(power):
    """An oscillator in units that are powers of two: the same bits, times the unit."""
    x = torch.tensor([[0.3, -0.2, 1e-3, 0.5], [0.0, 0.4, 0.0, 0.0]], dtype=torch.float64)
    turn = torch.tensor([[0, 0, 1, 0], [0, 0, 0, 1], [-1.0, 0, 0, 0], [0, -3, 0, 0]], dtype=torch.float64)
    method = GaussLegendre4()
    expected = method.increment(lambda x: x @ turn.T, x, 0.1)
    unit = 2.0**power
    assert torch.equal(method.increment(lambda x: x @ turn.T, unit * x, 0.1) / unit, expected)


def test_sizes_are_those_of_positions_and_of_momenta():
    """In other units, momenta of size 1e6 do not excuse positions of size one."""
    sizes = torch.tensor([[1.0, 2.0, 30.0, 40.0]])
    assert _of_block(sizes).tolist() == [[2.0, 2.0, 40.0, 40.0]]
    assert _of_block(sizes[:, :3]).tolist() == [[30.0, 30.0, 30.0]]
