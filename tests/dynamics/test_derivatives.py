"""Derivatives with respect to parameters, against central differences."""

from __future__ import annotations

import pytest
import torch
from helpers import generator
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import HamiltonianDynamics
from ahnn.dynamics.derivatives import field_jacobian, knows_velocities


@pytest.mark.parametrize(
    ("structure", "known"), [("generic", False), ("separable", False), ("mechanical", True)]
)
def test_the_field_moves_with_its_parameters_as_central_differences_say(structure, known):
    torch.manual_seed(0)
    dynamics = HamiltonianDynamics(
        2,
        hamiltonian=structure,
        inertia=2.0,
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 4, "depth": 2, "activation": "tanh"},
        integrator={"name": "rk4"},
    ).double()
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
