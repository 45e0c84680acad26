"""Symplectic methods keep the symplectic form and run backwards; every step may differ between members."""

from __future__ import annotations

import pytest
import torch
from helpers import SYSTEMS, close, random_states

from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS, SymmetricComposition
from ahnn.integrators.implicit import GaussLegendre4

KEPLER = SYSTEMS["kepler"]
SYMPLECTIC = [n for n, m in INTEGRATORS.items() if n == "gl4" or isinstance(m, SymmetricComposition)]


@pytest.mark.parametrize("name", SYMPLECTIC)
@pytest.mark.parametrize("system", ["kepler", "pendulum", "heavy_henon_heiles"])
def test_the_step_map_is_symplectic(name, system):
    system = SYSTEMS[system]
    step = INTEGRATORS[name].step
    eye, zero = torch.eye(system.dof), torch.zeros(system.dof, system.dof)
    j = torch.cat((torch.cat((zero, eye), 1), torch.cat((-eye, zero), 1))).double()
    for x in random_states(system, 3, seed=1):
        m = torch.autograd.functional.jacobian(lambda x: step(system, x.unsqueeze(0), 0.1)[0], x)
        assert float((m.T @ j @ m - j).norm()) <= 1e-10


def test_an_explicit_method_is_not_symplectic():
    system = SYSTEMS["kepler"]
    x = random_states(system, 1, seed=1)[0]
    m = torch.autograd.functional.jacobian(
        lambda x: INTEGRATORS["rk4"].step(system, x.unsqueeze(0), 0.1)[0], x
    )
    assert abs(float(torch.linalg.det(m)) - 1) > 1e-8


@pytest.mark.parametrize("name", SYMPLECTIC)
def test_a_step_back_returns_to_the_start(name):
    method = INTEGRATORS[name]
    start = x = random_states(KEPLER, 5, seed=2)
    for _ in range(10):
        x = method.step(KEPLER, x, 0.05)
    assert float((x - start).norm()) > 0.1
    for _ in range(10):
        x = method.step(KEPLER, x, -0.05)
    close(x, start, 1e-12)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_tensor_of_steps_equals_a_loop_over_numbers(name):
    method = INTEGRATORS[name]
    x = random_states(KEPLER, 4, seed=3)
    steps = torch.tensor([0.01, 0.02, -0.03, 0.05], dtype=torch.float64)
    together = method.step(KEPLER, x, steps)
    one_by_one = [method.step(KEPLER, x[b : b + 1], float(steps[b])) for b in range(4)]
    close(together, torch.cat(one_by_one), 1e-14)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_step_is_the_state_plus_its_increment(name):
    method = INTEGRATORS[name]
    x = random_states(KEPLER, 4, seed=4)
    assert torch.equal(method.step(KEPLER, x, 0.05), x + method.increment(KEPLER, x, 0.05))


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_step_is_differentiable(name):
    method = INTEGRATORS[name]
    x = random_states(KEPLER, 2, seed=5).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: method.step(KEPLER, x, 0.05), (x,), atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_step_keeps_float32(name):
    assert INTEGRATORS[name].step(KEPLER, random_states(KEPLER, 2, 6).float(), 0.01).dtype == torch.float32


def test_stages_that_do_not_converge_are_one_message_with_a_gradient_too():
    method = GaussLegendre4(max_iterations=1)
    x = random_states(KEPLER, 2, seed=4).requires_grad_()
    with pytest.raises(UserError, match=r"gl4: the stages of 2 of 2 states did not converge in 1 sweeps"):
        method.step(KEPLER, x, 0.1)
