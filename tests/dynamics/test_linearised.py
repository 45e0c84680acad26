"""Dynamics to first order in a step of their parameters, against their Jacobian by reverse mode."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import Swing
from torch.autograd.functional import jacobian
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import linearised as module
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import parametrised
from ahnn.dynamics.linearised import linearised, tangent

DOUBLE = {"dtype": torch.float64}
COMMON = {"scaling": "block", "integrator": {"name": "rk4"}}
PLAIN = {**COMMON, "inertia": 1.0, "mu": None, "inputs": "cartesian"}
ORBIT = {**PLAIN, "dof": 3, "inputs": "isotropic"}
KINDS = {
    "generic": ("hamiltonian", {**PLAIN, "dof": 1, "hamiltonian": "generic"}),
    "separable": ("hamiltonian", {**PLAIN, "dof": 2, "hamiltonian": "separable"}),
    "mechanical": ("hamiltonian", {**ORBIT, "hamiltonian": "mechanical"}),
    "central_body": ("hamiltonian", {**ORBIT, "hamiltonian": "central_body", "falloff": 3}),
    "node": ("node", {**COMMON, "dof": 2}),
}


@pytest.fixture(params=[(name, depth) for name in KINDS for depth in (1, 2, 3)], ids=str)
def dynamics(request):
    name, depth = request.param
    torch.manual_seed(depth)
    kind, options = KINDS[name]
    return make_dynamics(kind, **options, network={"width": 5, "depth": depth, "activation": "tanh"}).double()


def drawn(dynamics, size, seed=0):
    theta = parameters_to_vector(dynamics.parameters()).detach()
    return theta, size * torch.randn(len(theta), generator=generator(seed), **DOUBLE)


def states(dynamics):
    return 1 + torch.rand(7, 2 * dynamics.spec["dof"], generator=generator(3), **DOUBLE)


def slopes(dynamics, theta, x):
    return jacobian(lambda t: parametrised(dynamics, dynamics.field, t.dtype)(t, x), theta)


def test_derivatives_after_a_long_step_are_those_of_the_tangent(dynamics):
    """Also by mu, of no network, whose derivative changes by the factor of the step."""
    _, step = drawn(dynamics, 0.3)
    wide, places = linearised(dynamics, step)
    narrow, x = tangent(dynamics, wide, places), states(dynamics)
    found, expected = (
        slopes(one, parameters_to_vector(one.parameters()).detach(), x) for one in (narrow, wide)
    )
    close(found, expected[..., places], 1e-10)
    for name, parameter in dynamics.named_parameters():
        assert ("log_mu" not in name) or not torch.equal(parameter, narrow.get_parameter(name))


def test_the_field_moves_by_its_derivative_along_the_step(dynamics):
    theta, step = drawn(dynamics, 1e-4)
    wide, _ = linearised(dynamics, step)
    x = states(dynamics)
    close(
        wide.field(x) - dynamics.field(x), slopes(dynamics, theta, x) @ step, 1e-3
    )  # mu, of no network, moves by itself
    assert wide.spec["network"]["width"] == 15


def test_networks_stay_straight_however_long_the_step(dynamics):
    _, step = drawn(dynamics, 0.5)
    for (name, _), part in zip(
        dynamics.named_parameters(), step.split([p.numel() for p in dynamics.parameters()]), strict=True
    ):
        if "log_mu" in name:
            part.zero_()
    x = states(dynamics)
    here, half, whole = (
        (dynamics if s == 0 else linearised(dynamics, s * step)[0]).field(x) for s in (0, 0.5, 1.0)
    )
    close(whole - here, 2 * (half - here), 1e-4)


def test_parameters_at_their_places_move_the_field_as_they_did(dynamics):
    theta, step = drawn(dynamics, 1e-4)
    wide, places = linearised(dynamics, step)
    _, move = drawn(dynamics, 1.0, seed=1)
    x, flat = states(dynamics), parameters_to_vector(wide.parameters()).detach()
    close(slopes(wide, flat, x)[..., places] @ move, slopes(dynamics, theta, x) @ move, 1e-3)


def test_the_energy_of_a_hamiltonian_moves_as_its_field_does():
    torch.manual_seed(0)
    kind, options = KINDS["generic"]
    own = make_dynamics(kind, **options, network={"width": 5, "depth": 2, "activation": "tanh"}).double()
    wide, _ = linearised(own, drawn(own, 0.1)[1])
    x = states(own).requires_grad_()
    (slope,) = torch.autograd.grad(wide.energy(x).sum(), x)
    close(wide.field(x), torch.cat((slope[:, 1:], -slope[:, :1]), dim=1), 1e-9)


def test_dynamics_that_no_wider_network_makes_stay_as_they_are():
    assert linearised(Swing(), torch.ones(2, **DOUBLE)) is None


def test_parameters_that_grow_with_the_width_in_a_way_of_their_own_stay_as_they_are(monkeypatch):
    class Gated(Swing):
        def __init__(self, width):
            super().__init__()
            self.gate = torch.nn.Parameter(torch.ones(width, **DOUBLE))
            self.spec = {"kind": "gated", "network": {"width": width}}

    monkeypatch.setattr(module, "make_dynamics", lambda kind, network: Gated(network["width"]))  # noqa: ARG005
    assert module.linearised(Gated(4), torch.ones(6, **DOUBLE)) is None
