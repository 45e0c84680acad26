"""Derivatives with respect to parameters, against central differences."""

from __future__ import annotations

import pytest
import torch
from helpers import generator
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import HamiltonianDynamics
from ahnn.dynamics.derivatives import field_jacobian, increment_jacobian, knows_velocities


def dynamics_of(structure: str, inputs: str = "cartesian") -> HamiltonianDynamics:
    torch.manual_seed(0)
    return HamiltonianDynamics(
        2,
        hamiltonian=structure,
        inertia=2.0,
        mu=None,
        inputs=inputs,
        scaling="none",
        network={"width": 4, "depth": 2, "activation": "tanh"},
        integrator={"name": "rk4"},
    ).double()


@pytest.mark.parametrize(
    ("structure", "known"), [("generic", False), ("separable", False), ("mechanical", True)]
)
def test_the_field_moves_with_its_parameters_as_central_differences_say(structure, known):
    dynamics = dynamics_of(structure)
    assert knows_velocities(dynamics.field) is known
    x = torch.randn(3, 5, 4, generator=generator(1), dtype=torch.float64)
    theta = parameters_to_vector(dynamics.parameters()).detach()
    got, step = field_jacobian(dynamics)(theta, x), 1e-5
    moved = slice(2 if known else 0, 4)
    assert got.shape == (3, 5, 2 if known else 4, len(theta))
    for k in range(0, len(theta), 7):
        sides = []
        for sign in (1, -1):
            shifted = theta.clone()
            shifted[k] += sign * step
            vector_to_parameters(shifted, dynamics.parameters())
            sides.append(dynamics.field(x.flatten(0, 1)).detach().unflatten(0, (3, 5)))
        expected = (sides[0] - sides[1]) / (2 * step)
        assert known is False or not expected[..., :2].any()
        torch.testing.assert_close(got[..., k].double(), expected[..., moved], rtol=1e-4, atol=1e-5)
    vector_to_parameters(theta, dynamics.parameters())


@pytest.mark.parametrize("own_steps", [False, True])
@pytest.mark.parametrize("structure", ["generic", "mechanical"])
def test_a_step_moves_with_parameters_and_state_as_central_differences_say(structure, own_steps):
    dynamics = dynamics_of(structure)
    x, small = torch.randn(3, 4, generator=generator(1), dtype=torch.float64), 1e-5
    dt = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64) if own_steps else 0.2
    theta = parameters_to_vector(dynamics.parameters()).detach()
    by_theta, by_state = increment_jacobian(dynamics, dynamics.increment, torch.float64)(theta, x, dt)
    for k in range(0, len(theta), 7):
        sides = []
        for sign in (1, -1):
            shifted = theta.clone()
            shifted[k] += sign * small
            vector_to_parameters(shifted, dynamics.parameters())
            sides.append(dynamics.increment(x, dt).detach())
        torch.testing.assert_close(
            by_theta[..., k], (sides[0] - sides[1]) / (2 * small), rtol=1e-7, atol=1e-9
        )
    vector_to_parameters(theta, dynamics.parameters())
    for k in range(4):
        shift = small * torch.eye(4, dtype=torch.float64)[k]
        change = dynamics.increment(x + shift, dt) - dynamics.increment(x - shift, dt)
        torch.testing.assert_close(by_state[..., k], change.detach() / (2 * small), rtol=1e-7, atol=1e-9)
