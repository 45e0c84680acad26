"""Jacobians of steps in closed form are those of reverse mode, and Hessians those of automatic ones."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from helpers import close, generator
from hypothesis import given
from hypothesis import strategies as st
from planar import planar
from torch.func import jacrev, vmap
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import variations
from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.derivatives import parametrised
from ahnn.dynamics.variations import jacobians_of_steps, own_jacobians
from ahnn.jacobians import step_jacobians

WIDE = torch.float64


def far_from_the_centre(*shape, seed=1):
    x = torch.rand(*shape, generator=generator(seed), dtype=WIDE) + 0.5
    return x * torch.where(torch.rand(x.shape, generator=generator(seed + 1)) < 0.5, -1.0, 1.0)


def both_ways(own, dtype=WIDE):
    """Jacobians of 21 steps by what the dynamics offer, and by reverse mode."""
    x, dt = far_from_the_centre(7, 3, 4), 0.1 + 0.2 * torch.rand(7, 3, generator=generator(2), dtype=WIDE)
    theta = parameters_to_vector(own.parameters()).detach()
    increment = partial(parametrised(own, own.increment, WIDE), theta)
    return jacobians_of_steps(own, dtype)(theta, x, dt), step_jacobians(increment, x, dt)


@pytest.fixture
def no_reverse_mode(monkeypatch):
    def refused(*_):
        raise AssertionError("reverse mode")

    monkeypatch.setattr(variations, "mapped_jacobians_of_steps", refused)
    monkeypatch.setattr(variations, "SAMPLES", 4)


@pytest.mark.parametrize("inputs", ["cartesian", "isotropic", "radial"])
@pytest.mark.parametrize(
    ("structure", "mu", "falloff"),
    [
        ("generic", None, 0),
        ("separable", None, 0),
        ("separable", None, 1.5),
        ("mechanical", None, 0),
        ("central_body", None, 0),
        ("central_body", 1.3, 3),
    ],
)
@pytest.mark.usefixtures("no_reverse_mode")
def test_structures_and_inputs(structure, mu, falloff, inputs):
    close(*both_ways(planar(structure, mu=mu, falloff=falloff, inputs=inputs)), 1e-12)


@pytest.mark.parametrize(
    "method", ["euler", "midpoint", "rk4", "dopri8", "leapfrog", "yoshida4", "kahan_li8"]
)
@pytest.mark.usefixtures("no_reverse_mode")
def test_methods(method):
    close(*both_ways(planar(method=method)), 1e-12)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("depth", [1, 3])
@pytest.mark.usefixtures("no_reverse_mode")
def test_networks(activation, depth):
    close(*both_ways(planar(activation=activation, depth=depth, falloff=3.0)), 1e-12)


@pytest.mark.usefixtures("no_reverse_mode")
def test_parameters_are_those_asked_for():
    own = planar()
    theta = parameters_to_vector(own.parameters()).detach()
    x, dt = far_from_the_centre(2, 3, 4), torch.full((2, 3), 0.2, dtype=WIDE)
    given_to = jacobians_of_steps(own, WIDE)
    first = given_to(theta, x, dt)
    increment = partial(parametrised(own, own.increment, WIDE), 1.5 * theta)
    close(given_to(1.5 * theta, x, dt), step_jacobians(increment, x, dt), 1e-12)
    assert float((given_to(1.5 * theta, x, dt) - first).abs().max()) > 1e-3
    close(parameters_to_vector(own.parameters()), theta, 0)
    found = own_jacobians(own)(x, dt)
    assert found.dtype == torch.float32
    close(found.double(), first, 1e-5)


def test_methods_that_iterate_take_reverse_mode():
    own = planar(method="gl4")
    found, expected = both_ways(own)
    close(found, expected, 1e-12)
    close(found, both_ways(planar(method="dopri8"))[0], 1e-2)


@given(st.integers(0, 10_000), st.sampled_from(["cartesian", "isotropic", "radial"]), st.floats(0.5, 6))
def test_hessians_are_those_of_automatic_derivatives(seed, inputs, falloff):
    energy = planar("central_body", mu=1.3, falloff=falloff, inputs=inputs).field.potential
    q = far_from_the_centre(6, 2, seed=seed)
    gradient, found = energy.derivatives(q)
    close(gradient, energy.gradient(q), 1e-12)
    close(found, vmap(jacrev(jacrev(energy)))(q), 1e-11)
