"""Gradients that are written out equal those of autograd: values, first and second derivatives."""

from __future__ import annotations

import pytest
import torch
from helpers import generator
from torch.func import jacrev, vmap

from ahnn.dynamics import HamiltonianDynamics, native
from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.gradients import plain_gradient
from ahnn.dynamics.networks import Perceptron
from ahnn.integrators import ExplicitRungeKutta
from ahnn.integrators.base import column

METHODS = ("euler", "midpoint", "rk4", "dopri5", "dopri8")
OWN_STEPS = torch.tensor((0.1, 0.3, 0.2, 0.25, 0.15), dtype=torch.float64)


@pytest.fixture(autouse=True, params=["in C", "single operations"])
def _both_ways(request, monkeypatch):
    if request.param != "in C":
        monkeypatch.setattr(native, "library", lambda _: None)


def dynamics(
    activation: str, method: str = "rk4", depth: int = 3, *, width=5, dof=2, dtype=torch.float64
) -> HamiltonianDynamics:
    torch.manual_seed(0)
    found = HamiltonianDynamics(
        dof,
        hamiltonian="generic",
        inertia=1.0,
        mu=None,
        inputs="cartesian",
        scaling="block",
        network={"width": width, "depth": depth, "activation": activation},
        integrator={"name": method},
    ).to(dtype)
    field = found.field
    for part in (field.positions.affine, field.momenta.affine):
        part.shift.normal_()
        part.scale.uniform_(0.5, 2.0)
    field.unit.fill_(1.7)
    torch.nn.init.normal_(field.network.output.weight)
    return found


def plain_field(own: HamiltonianDynamics):
    """The field as autograd has it from the energy itself."""

    def field(x):
        x = x if x.requires_grad else x.detach().requires_grad_()
        gradient = torch.autograd.grad(own.energy(x).sum(), x, create_graph=True)[0]
        return torch.cat((gradient[..., 2:], -gradient[..., :2]), dim=-1)

    return field


def inputs_of(own: HamiltonianDynamics) -> list[torch.Tensor]:
    return [p for name, p in own.named_parameters() if not name.endswith("output.bias")]


def require_close(found, expected) -> None:
    for one, other in zip(found, expected, strict=True):
        assert float((one - other).detach().abs().max()) <= 1e-12 * float(other.detach().abs().max())


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize(("method", "dt"), [*((m, 0.2) for m in METHODS), ("rk4", OWN_STEPS)])
def test_steps_and_their_first_and_second_derivatives_are_those_of_autograd(activation, method, dt):
    own = dynamics(activation, method)
    x = torch.randn(5, 4, generator=generator(1), dtype=torch.float64).requires_grad_()
    v = torch.randn(5, 4, generator=generator(2), dtype=torch.float64)
    asked = [x, *inputs_of(own)]
    integrator = own.integrator
    assert isinstance(integrator, ExplicitRungeKutta)
    field, found = plain_field(own), []
    for step in (own.increment, lambda x, dt: integrator.increment(field, x, dt)):
        twice = x + step(x, dt)
        value = twice + step(twice, dt)
        first = torch.autograd.grad(value, asked, v, retain_graph=True)
        linked = torch.autograd.grad(value, asked, v, create_graph=True)
        second = torch.autograd.grad(sum(t.square().sum() for t in linked), asked)
        found.append((value, *first, *linked, *second))
    require_close(*found)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("depth", [1, 2])
def test_the_reverse_holds_against_finite_differences(activation, depth):
    own = dynamics(activation, depth=depth)
    x = torch.randn(3, 4, generator=generator(1), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, *_: own.increment(x, 0.2), (x, *inputs_of(own)))


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_network_gradient_is_that_of_single_operations_far_from_the_origin_too(activation):
    torch.manual_seed(0)
    network = Perceptron(3, 1, width=7, depth=2, activation=activation).double()
    z = 8 * torch.randn(2, 50, 3, generator=generator(1), dtype=torch.float64)
    v = torch.randn(2, 50, 3, generator=generator(2), dtype=torch.float64)
    asked = inputs_of(network)
    found = []
    for value in (network.gradient(z), plain_gradient(z, network.layers(), network.activation)):
        found.append((value, *torch.autograd.grad(value, asked, v)))
    require_close(*found)
    with torch.inference_mode():
        assert torch.equal(network.gradient(z), found[0][0])


@pytest.mark.parametrize("learned", [False, True])
def test_the_length_of_a_step_has_a_gradient(learned):
    own = dynamics("gelu").requires_grad_(learned)
    x = torch.randn(5, 4, generator=generator(1), dtype=torch.float64)
    dt = OWN_STEPS.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda dt: own.increment(x, dt), (dt,))


def test_transforms_of_functions_see_through_a_step():
    own = dynamics("gelu")
    x = torch.randn(4, 4, generator=generator(1), dtype=torch.float64)
    single = vmap(jacrev(lambda x: own.increment(x.unsqueeze(0), 0.2).squeeze(0)))(x)
    rows = torch.autograd.functional.jacobian(lambda x: own.increment(x, 0.2).sum(0), x)
    torch.testing.assert_close(single, rows.transpose(0, 1), rtol=1e-12, atol=1e-13)


def test_one_operation_stands_between_states_and_parameters():
    own = dynamics("gelu")
    x = torch.randn(4, 4, generator=generator(1), dtype=torch.float64)
    assert type(own.increment(x, column(0.2)).grad_fn).__name__ == "_StepBackward"


def test_several_cotangents_at_once_are_those_one_by_one():
    own = dynamics("gelu")
    x = torch.randn(4, 4, generator=generator(1), dtype=torch.float64).requires_grad_()
    v = torch.randn(3, 4, 4, generator=generator(2), dtype=torch.float64)
    asked = [x, *inputs_of(own)]
    found = torch.autograd.grad(own.increment(x, 0.2), asked, v, is_grads_batched=True)
    one_by_one = [torch.autograd.grad(own.increment(x, 0.2), asked, u) for u in v]
    require_close(found, [torch.stack(rows) for rows in zip(*one_by_one, strict=True)])
