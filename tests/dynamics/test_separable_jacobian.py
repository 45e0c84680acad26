"""The Jacobian of a Hamiltonian's field in closed form is that of vectorised reverse mode."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from planar import planar
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import HamiltonianDynamics, separable_jacobian
from ahnn.dynamics.derivatives import field_jacobian, mapped_field_jacobian
from ahnn.dynamics.separable_jacobian import has_generic_rows, has_separable_rows

WIDE = torch.float64


@pytest.mark.parametrize("inputs", ["cartesian", "isotropic", "radial"])
@pytest.mark.parametrize(
    ("structure", "mu", "falloff", "rows"),
    [
        ("generic", None, 0, 4),
        ("separable", None, 0, 4),
        ("separable", None, 1.5, 4),
        ("mechanical", None, 0, 2),
        ("central_body", None, 0, 2),
        ("central_body", 1.3, 3, 2),
    ],
)
def test_rows_of_a_field(monkeypatch, structure, mu, falloff, rows, inputs):
    monkeypatch.setattr(separable_jacobian, "SAMPLES", 4)
    own = planar(structure, mu=mu, falloff=falloff, inputs=inputs)
    assert (has_generic_rows if structure == "generic" else has_separable_rows)(own.field)
    theta = parameters_to_vector(own.parameters()).detach()
    x = torch.randn(7, 3, 4, generator=generator(1), dtype=WIDE)
    factors = torch.rand(7, 3, 4, generator=generator(2), dtype=WIDE) + 0.5
    found = field_jacobian(own, WIDE)(theta, x, factors)
    assert found.shape == (7, 3, rows, len(theta))
    close(found, mapped_field_jacobian(own, WIDE)(theta, x, factors), 1e-12)


def test_an_energy_of_another_kind_has_none():
    own = HamiltonianDynamics(
        2,
        hamiltonian="generic",
        inertia=1.0,
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 4, "depth": 1},
        integrator={"name": "rk4"},
    )
    assert not has_separable_rows(own.field)
