"""The learned mass matrix: its field is that of its energy, which conserves it and is never negative."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.data.generate import generate
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.systems import CartPole, ChainPendulum

DOUBLE = ChainPendulum(name="double", dt=0.02, steps=50)


def dynamics(system=DOUBLE, **options):
    torch.manual_seed(0)
    given = {"hamiltonian": "mass_matrix", "inertia": 1.0, "mu": None, "inputs": "angles", "scaling": "block"}
    given |= {"network": {"width": 8, "depth": 2, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    found = HamiltonianDynamics(system.dof, angular=system.space.angular, **given | options).double()
    found.fit(Statistics.of(generate(system, 8, 0)))
    return found


@pytest.mark.parametrize("inputs", ["angles", "cartesian"])
@pytest.mark.parametrize("system", [DOUBLE, CartPole(name="cart", dt=0.02, steps=50)], ids=lambda s: s.name)
def test_the_field_is_that_of_the_energy(system, inputs):
    found = dynamics(system, inputs=inputs)
    x = generate(system, 4, 1).states[:, ::10].flatten(0, 1).requires_grad_()
    (slope,) = torch.autograd.grad(found.energy(x).sum(), x)
    dq, dp = slope.chunk(2, dim=-1)
    close(found.field(x), torch.cat((dp, -dq), dim=-1), 1e-12)


def test_bodies_at_rest_do_not_move_and_momentum_costs_energy():
    found = dynamics()
    q = torch.randn(50, 2, dtype=torch.float64, generator=generator(3))
    p = torch.randn(50, 2, dtype=torch.float64, generator=generator(4))
    rest = torch.cat((q, torch.zeros_like(p)), dim=-1)
    assert float(found.field(rest).detach()[:, :2].abs().max()) == 0.0
    assert bool((found.energy(torch.cat((q, p), dim=-1)) > found.energy(rest)).all())


def test_angles_have_the_period_of_a_turn():
    found = dynamics()
    x = DOUBLE.initial_states(5, generator(5))
    turned = x + 2 * torch.pi * torch.tensor([1.0, -2.0, 0.0, 0.0], dtype=torch.float64)
    close(found.field(turned), found.field(x), 1e-9)


def test_what_it_has_not_is_refused():
    with pytest.raises(UserError, match="falloff: expected 0, since mass_matrix has no V"):
        dynamics(falloff=2.0)
    with pytest.raises(UserError, match="mu: expected None, since mass_matrix has no central body"):
        dynamics(mu=1.0)


def test_its_network_sees_positions_alone_as_the_training_has_them():
    found = dynamics(inputs="cartesian")
    states = generate(DOUBLE, 8, 0).states.flatten(0, 1)
    seen = found.field.seen(states)
    assert seen.shape == (len(states), 2)
    close(seen, found.field.positions(states[:, :2]), 0)
    close(seen.abs().max(), torch.tensor(1.0), 1e-6)
