"""Bodies in the plane: forces, conserved sums, and the motion of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import close, generator
from scipy.integrate import solve_ivp

from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.rollouts import rollout
from ahnn.systems import NBody, exact_flow
from ahnn.systems.encounters import conserved
from ahnn.systems.energy_check import require_conserved

FOUR = NBody(name="four", dt=0.01, steps=100, bodies=4, masses=[1.0, 2.0, 0.5, 1.5])


def test_the_field_is_that_of_the_energy():
    x = FOUR.initial_states(6, generator(0)).requires_grad_()
    (slope,) = torch.autograd.grad(FOUR.energy(x).sum(), x)
    dq, dp = slope.chunk(2, dim=-1)
    close(FOUR.hamiltonian(x), torch.cat((dp, -dq), dim=-1), 1e-12)


def test_momentum_angular_momentum_and_energy_are_conserved():
    found = generate(FOUR, 10, 1).states
    q, p = (part.unflatten(-1, (4, 2)) for part in found.chunk(2, dim=-1))
    turning = (q[..., 0] * p[..., 1] - q[..., 1] * p[..., 0]).sum(-1)
    for kept in (p.sum(-2)[..., 0], p.sum(-2)[..., 1], turning, FOUR.energy(found)):
        assert float((kept - kept[:, :1]).abs().max()) < 1e-8 * float(p.abs().max())


def test_equal_bodies_without_disorder_turn_as_a_polygon():
    circle = NBody(name="circle", dt=0.01, steps=200, bodies=5, disorder=0.0)
    q = generate(circle, 3, 2).states[..., :10].unflatten(-1, (5, 2)).norm(dim=-1)
    assert float((q - q[:, :1]).abs().max()) < 1e-9


def test_the_motion_is_scipy_s():
    x = FOUR.initial_states(1, generator(3))
    field = lambda _, y: FOUR.hamiltonian(torch.as_tensor(y)).numpy()  # noqa: E731
    expected = solve_ivp(field, (0, 1), x[0].numpy(), rtol=1e-12, atol=1e-13).y[:, -1]
    found = generate(FOUR, 1, 3).states[0, -1]
    close(found, torch.as_tensor(expected), 1e-8)


def test_close_encounters_are_those_of_scipy():
    system = NBody(name="unequal", dt=0.01, steps=500, masses=[1.0, 1.5, 0.8])
    x = system.initial_states(200, generator(0))[[41]]
    flow = exact_flow(system)
    assert not conserved(system, x, rollout(flow._replace(guarded=False), x, 5.0, 2)[:, -1]).any()
    found = rollout(flow, x, system.dt, 501)
    energy = system.energy(found)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-7
    masses = np.array([1.0, 1.5, 0.8])

    def field(_, y):
        q, p = y.reshape(2, 3, 2)
        apart = q - q[:, None]
        cubes = (apart**2).sum(-1) ** 1.5 + np.eye(3)
        pull = (masses[:, None] * masses / cubes)[..., None] * apart
        return np.concatenate(((p / masses[:, None]).ravel(), pull.sum(1).ravel()))

    expected = solve_ivp(field, (0, 5), x[0].numpy(), "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    close(found[0, -1], torch.as_tensor(expected), 1e-4)
    each = torch.tensor([system.dt, 2 * system.dt], dtype=torch.float64)
    close(flow(found[0, [300, 300]], each), found[0, [301, 302]], 1e-9)


def test_trajectories_that_lose_energy_are_reported_or_refused(caplog):
    states = generate(FOUR, 3, 5).states
    require_conserved(FOUR, states, 7)
    assert not caplog.messages
    states[1, -1, 8:] *= 1 + 1e-4
    require_conserved(FOUR, states, 7)
    assert "1 of 3 trajectories change their energy, by up to 0.0" in caplog.text
    assert "(trajectory 8)" in caplog.text
    states[1, -1, 8:] *= 1.1
    with pytest.raises(UserError, match="expected reference states that conserve the energy; received traj"):
        require_conserved(FOUR, states, 7)


def test_one_body_and_masses_of_others_are_refused():
    with pytest.raises(UserError, match="bodies: expected at least two; received 1"):
        NBody(name="one", dt=0.1, steps=3, bodies=1)
    with pytest.raises(UserError, match=r"masses: expected one number for each of 3 bodies; received"):
        NBody(name="one", dt=0.1, steps=3, masses=[1.0])
