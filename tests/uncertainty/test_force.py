"""The deviation of a learned force: closed forms of an oscillator, and directions that are left out."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing
from torch import nn

from ahnn.dynamics.energies import Quadratic
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
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


class Potential(nn.Module):
    """The sum of a q_i^2 / 2 + b q_i^4 / 4."""

    def __init__(self, a, b):
        super().__init__()
        self.stiffness = nn.Parameter(torch.tensor([a, b], **DOUBLE))

    def gradient(self, q):
        return self.stiffness[0] * q + self.stiffness[1] * q**3


class Well(Swing):
    """Dynamics whose kinetic energy is known, so that parameters move the momenta alone."""

    def __init__(self, a=2.0, b=0.5):
        nn.Module.__init__(self)
        self.field = SeparableHamiltonian(Quadratic(2.0), Potential(a, b))


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_the_deviation_is_that_of_forces_also_where_parameters_move_nothing_else(dof):
    """The root mean square over the components, as a fraction of the size of the force."""
    x = torch.randn(40, 2 * dof, generator=generator(4), **DOUBLE)
    q = x[:, :dof]
    moved = torch.stack((-q, -(q**3)), dim=-1) @ FACTOR
    expected = (moved.square().sum((-2, -1)) / dof).sqrt() / (2 * q + 0.5 * q**3).norm(dim=-1)
    close(force_deviation(Well(), FACTOR, x)(x), expected, 2e-4)
    if dof == 1:
        close(expected, exact(x), 1e-12)


def test_directions_that_do_not_move_the_force_cost_nothing():
    widened = torch.cat((FACTOR, torch.zeros(2, 30, **DOUBLE)), dim=1)
    close(force_deviation(Swing(), widened, states())(states()), exact(states()), 2e-4)


@pytest.mark.parametrize("factor", [FACTOR, torch.zeros_like(FACTOR)])
def test_where_there_is_no_force_the_fraction_is_finite(factor):
    assert bool(force_deviation(Swing(), factor, states())(torch.zeros(3, 2, **DOUBLE)).isfinite().all())
