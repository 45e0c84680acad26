"""A recorded flow is the flow, to rounding; what iterates is not recorded."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import make_dynamics
from ahnn.dynamics import recorded_flow as module
from ahnn.dynamics.recorded_flow import Increments, recorded

NETWORK = {"width": 8, "depth": 2, "activation": "tanh"}


def dynamics(integrator, hamiltonian="mechanical"):
    options = {"hamiltonian": hamiltonian, "mu": None, "inputs": "isotropic", "scaling": "block"}
    options |= {"network": NETWORK, "integrator": {"name": integrator}, "inertia": 2.0}
    return make_dynamics("hamiltonian", dof=3, **options).double().requires_grad_(False)


@pytest.mark.parametrize("integrator", ["rk4", "dopri5", "leapfrog", "yoshida6"])
@pytest.mark.parametrize("hamiltonian", ["mechanical", "separable", "central_body"])
def test_a_recorded_flow_gives_the_same_numbers(integrator, hamiltonian):
    torch.manual_seed(0)
    flow = dynamics(integrator, hamiltonian)
    again = recorded(flow)
    assert again is not flow
    with torch.inference_mode():
        for count, dt in ((13, 0.1), (13, 0.7), (19, 1e-3)):
            x = torch.randn(count, 6, dtype=torch.float64)
            close(again(x, dt), flow(x, dt), 1e-14)


def test_what_iterates_and_what_is_no_dynamics_comes_back_as_it_is():
    flow = dynamics("gl4")
    assert recorded(flow) is flow
    assert recorded(torch.add) is torch.add


@torch.no_grad()
@pytest.mark.parametrize(
    ("integrator", "hamiltonian", "gains"),
    [
        ("rk4", "central_body", True),
        ("leapfrog", "separable", True),
        ("gl4", "mechanical", False),
        ("rk4", "generic", True),
    ],
)
def test_increments_of_any_parameters_and_states_are_recorded_where_that_gains(
    integrator, hamiltonian, gains
):
    torch.manual_seed(0)
    flow = dynamics(integrator, hamiltonian)
    before, own = parameters_to_vector(flow.parameters()), dynamics(integrator, hamiltonian)
    increments, few = Increments(flow, calls=module.WORTH + 1), Increments(flow, calls=1)
    for call, count in enumerate((5, 7, 5, 9, 5, 2, 300)):
        theta = (1 + 0.1 * (call // 2)) * before
        vector_to_parameters(theta, own.parameters())
        x = 1 + 0.1 * torch.randn(count, 6, dtype=torch.float64)
        dt = 0.1 * torch.rand(count, dtype=torch.float64)
        close(increments(theta, x, dt), own.increment(x, dt), 1e-13)
        assert torch.equal(few(theta, x, dt), own.increment(x, dt))
    assert (increments._recorded is not None) == gains
    assert few._recorded is None
    assert torch.equal(parameters_to_vector(flow.parameters()), before)


@torch.no_grad()
def test_a_recording_serves_the_same_dynamics_until_more_than_parameters_changes():
    torch.manual_seed(0)
    flow = dynamics("rk4", "central_body")
    theta, dt = parameters_to_vector(flow.parameters()), torch.tensor([0.1], dtype=torch.float64)
    x = 1 + 0.1 * torch.randn(1, 6, dtype=torch.float64)

    def recording():
        increments = Increments(flow, calls=module.WORTH + 1)
        close(increments(theta, x, dt), flow.increment(x, dt), 1e-13)
        return increments._recorded

    first = recording()
    vector_to_parameters(1.1 * theta, flow.parameters())
    theta = 1.1 * theta
    assert recording() is first
    for buffer in flow.buffers():
        buffer.mul_(1.5)
    second = recording()
    assert second is not first
    flow.integrator = dynamics("leapfrog").integrator
    assert recording() is not second
