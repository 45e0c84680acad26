"""A step with its state transition, of whatever flow: the step, and central differences of it."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.dynamics import HamiltonianDynamics
from ahnn.dynamics.transition import transition


def learned(hamiltonian, integrator):
    torch.manual_seed(0)
    return HamiltonianDynamics(
        2,
        hamiltonian=hamiltonian,
        inertia=2.0,
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 6, "depth": 2, "activation": "tanh"},
        integrator={"name": integrator},
    ).double()


FLOWS = {
    "in closed form, explicit": learned("generic", "rk4"),
    "in closed form, composed": learned("mechanical", "leapfrog"),
    "implicit": learned("generic", "gl4"),
    "a function": lambda x, dt: x + dt * torch.stack((x[:, 1], x[:, 0] * x[:, 2], x[:, 3] ** 2, x[:, 0]), -1),
}


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("flow", FLOWS.values(), ids=FLOWS)
def test_a_transition_is_the_derivative_of_the_step(flow, recorded):
    x, small = torch.randn(5, 4, generator=generator(1), dtype=torch.float64), 1e-5
    with torch.set_grad_enabled(recorded):
        after, matrices = transition(flow, x, 0.3)
    with torch.no_grad():
        close(after, flow(x, 0.3), 1e-12)
        shifts = small * torch.eye(4, dtype=torch.float64)
        columns = [(flow(x + shift, 0.3) - flow(x - shift, 0.3)) / (2 * small) for shift in shifts]
    close(matrices, torch.stack(columns, -1), 1e-8)


def test_a_flow_that_knows_its_transition_is_asked():
    class Knowing:
        def transition(self, x, dt):
            return x + dt, "its own"

    after, own = transition(Knowing(), torch.zeros(2, 2), 0.5)
    assert after.tolist() == [[0.5, 0.5]] * 2
    assert own == "its own"
