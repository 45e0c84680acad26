"""Systems in generalised coordinates: Hamilton's equations, energies, and motions of other derivations."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from scipy.integrate import solve_ivp

from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.rollouts import rollout
from ahnn.systems import CartPole, ChainPendulum, exact_flow

CART = CartPole(name="cart", dt=0.02, steps=100, pole=0.3, mass=1.4, length=0.7)
DOUBLE = ChainPendulum(name="double", dt=0.02, steps=100)
TRIPLE = ChainPendulum(
    name="triple", dt=0.004, steps=80, links=3, masses=[1.0, 2.5, 0.5], lengths=[1.0, 0.4, 2.0]
)


@pytest.mark.parametrize("system", [CART, DOUBLE, TRIPLE], ids=lambda system: system.name)
def test_the_field_is_that_of_the_energy(system):
    x = torch.randn(7, 2 * system.dof, dtype=torch.float64, generator=generator(0)).requires_grad_()
    (slope,) = torch.autograd.grad(system.energy(x).sum(), x)
    dq, dp = slope.chunk(2, dim=-1)
    close(system.hamiltonian(x), torch.cat((dp, -dq), dim=-1), 1e-12)


@pytest.mark.parametrize("system", [DOUBLE, TRIPLE], ids=lambda system: system.name)
def test_a_chain_conserves_its_energy_and_velocities_are_those_of_the_positions(system):
    found = generate(system, 6, 1)
    energy = system.energy(found.states)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-7 * float(energy.abs().max())
    v = system.velocities(found.states)
    central = (found.states[:, 2:] - found.states[:, :-2])[..., : system.dof] / (2 * system.dt)
    close(central, v[:, 1:-1], 5e-3 if system is TRIPLE else 2e-2)
    close(system.states(found.states[..., : system.dof], v), found.states, 1e-12)


def test_a_double_pendulum_moves_as_newton_s_equations_of_its_masses_say():
    """Two point masses in the plane with the tensions of the rods as unknowns, and no mass matrix."""

    def newton(_, y):
        r1, r2, v1, v2 = y[0:2], y[2:4], y[4:6], y[6:8]
        d, w = r2 - r1, v2 - v1
        # r1.a1 = -v1^2 and d.(a2 - a1) = -w^2, with a1 = g - s1 r1 + s2 d, a2 = g - s2 d
        g = torch.tensor([0.0, -9.81], dtype=torch.float64).numpy()
        left = [[-(r1 @ r1), r1 @ d], [d @ r1, -2 * (d @ d)]]
        right = [-(v1 @ v1) - r1 @ g, -(w @ w)]
        s1, s2 = torch.linalg.solve(torch.tensor(left), torch.tensor(right)).tolist()
        return [*v1, *v2, *(g - s1 * r1 + s2 * d), *(g - s2 * d)]

    q, v = torch.tensor([[1.1, -0.4]], dtype=torch.float64), torch.tensor([[0.3, -1.2]], dtype=torch.float64)
    one, two = q[0].tolist()
    r1 = torch.tensor([q[0, 0].sin(), -q[0, 0].cos()], dtype=torch.float64)
    d = torch.tensor([q[0, 1].sin(), -q[0, 1].cos()], dtype=torch.float64)
    v1 = v[0, 0] * torch.tensor([q[0, 0].cos(), q[0, 0].sin()], dtype=torch.float64)
    w = v[0, 1] * torch.tensor([q[0, 1].cos(), q[0, 1].sin()], dtype=torch.float64)
    begin = torch.cat((r1, r1 + d, v1, v1 + w)).numpy()
    found = solve_ivp(newton, (0, 2), begin, rtol=1e-11, atol=1e-12, t_eval=[2.0]).y[:, -1]
    ours = rollout(exact_flow(DOUBLE), DOUBLE.states(q, v), 0.02, 101)[0, -1]
    expected = torch.tensor(
        [found[0], -found[1], found[2] - found[0], found[1] - found[3]], dtype=torch.float64
    )
    mine = torch.stack((ours[0].sin(), ours[0].cos(), ours[1].sin(), ours[1].cos()))
    close(mine, expected, 1e-7)
    assert (one, two) == (1.1, -0.4)


def test_a_pushed_cart_gains_the_momentum_of_the_push():
    found = generate(CART, 5, 2)
    assert found.controls is not None
    pushed = (found.controls[:, :-1, 0] * CART.dt).cumsum(1)
    close(found.states[:, 1:, 2], pushed, 1e-9)  # nothing else has a force along the rail
    assert len({float(u) for u in found.controls[0, : CART.held, 0]}) == 1


def test_numbers_for_another_count_of_links_are_refused():
    with pytest.raises(UserError, match=r"masses: expected one number for each of 2 links; received \[1.0\]"):
        ChainPendulum(name="chain", dt=0.1, steps=3, masses=[1.0])
