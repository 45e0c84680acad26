"""A recorded flow is the flow, bit for bit; what iterates is not recorded."""

from __future__ import annotations

import pytest
import torch

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.recorded import recorded

NETWORK = {"width": 8, "depth": 2, "activation": "tanh"}


def dynamics(integrator, hamiltonian="mechanical"):
    options = {"hamiltonian": hamiltonian, "mu": None, "inputs": "isotropic", "scaling": "block"}
    options |= {"network": NETWORK, "integrator": {"name": integrator}, "inertia": 2.0}
    return make_dynamics("hamiltonian", dof=3, **options).double().requires_grad_(False)


@pytest.mark.parametrize("integrator", ["rk4", "dopri5", "leapfrog", "yoshida6"])
@pytest.mark.parametrize("hamiltonian", ["mechanical", "separable", "central_body"])
def test_a_recorded_flow_gives_the_same_bits(integrator, hamiltonian):
    torch.manual_seed(0)
    flow = dynamics(integrator, hamiltonian)
    again = recorded(flow)
    assert again is not flow
    with torch.inference_mode():
        for count, dt in ((13, 0.1), (13, 0.7), (19, 1e-3)):
            x = torch.randn(count, 6, dtype=torch.float64)
            assert torch.equal(again(x, dt), flow(x, dt))


def test_what_iterates_and_what_is_no_dynamics_comes_back_as_it_is():
    flow = dynamics("gl4")
    assert recorded(flow) is flow
    assert recorded(torch.add) is torch.add
