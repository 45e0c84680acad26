"""A steady flow is the flow to rounding, and the flow itself where derivatives are wanted."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close, generator
from torch.func import vmap

from ahnn.dynamics import make_dynamics
from ahnn.dynamics import steady as room
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.steady import SteadyFlow
from ahnn.integrators import INTEGRATORS
from ahnn.integrators.tableaus import EULER
from ahnn.libraries import PART
from ahnn.rollouts import rollout
from ahnn.types import steady

F64 = torch.float64


def dynamics(activation="gelu", width=13, depth=2, integrator="rk4", hamiltonian="generic", dof=3):
    torch.manual_seed(0)
    options = {"hamiltonian": hamiltonian, "mu": None, "inputs": "cartesian", "scaling": "minmax"}
    network = {"width": width, "depth": depth, "activation": activation}
    options |= {"network": network, "integrator": {"name": integrator}, "inertia": 1.0}
    found = make_dynamics("hamiltonian", dof=dof, **options).double().requires_grad_(False)
    for name, buffer in found.named_buffers():
        if name.endswith(("scale", "shift", "unit")):
            buffer.copy_(0.5 + torch.rand(buffer.shape, generator=generator(1)))
    if hamiltonian == "generic":
        found.field.unit.mul_(30.0)  # increments as large as the states
    return found


def states(count, dof=3):
    return torch.randn(count, 2 * dof, generator=generator(2), dtype=F64)


def by_autograd(flow, x, dt):
    """The integrator along J grad H, H's gradient by autograd."""

    def field(x):
        x = x.detach().requires_grad_()
        (gradient,) = torch.autograd.grad(flow.energy(x).sum(), x)
        dq, dp = gradient.chunk(2, dim=-1)
        return torch.cat((dp, -dq), dim=-1)

    return x + flow.integrator.increment(field, x, dt)


@pytest.mark.parametrize("activation", ["gelu", "tanh", "silu"])
@pytest.mark.parametrize(("width", "depth", "dof"), [(13, 2, 3), (8, 1, 1), (40, 3, 5)])
def test_a_steady_flow_follows_the_gradient_of_the_energy(activation, width, depth, dof):
    flow, x = dynamics(activation, width, depth, dof=dof), states(37, dof)
    assert isinstance(steady(flow), SteadyFlow)
    close(steady(flow)(x, 0.3) - x, by_autograd(flow, x, 0.3) - x, 1e-14)


@pytest.mark.parametrize("name", [name for name, method in INTEGRATORS.items() if hasattr(method, "tableau")])
def test_it_takes_every_explicit_method_and_a_step_for_each(name):
    flow, x = dynamics(integrator=name), states(21)
    lengths = 0.1 + torch.rand(21, generator=generator(3), dtype=F64)
    for dt in (0.2, torch.tensor(0.2), torch.tensor(0.2, dtype=F64), lengths):
        close(steady(flow)(x, dt) - x, by_autograd(flow, x, dt) - x, 1e-14)


def slope(activation, z):
    """The derivative of an activation at one number, by the functions of libm."""
    if activation == "gelu":
        cumulative = math.erfc(-z / math.sqrt(2)) / 2
        return cumulative + z * math.exp(-z * z / 2) / math.sqrt(2 * math.pi)
    if activation == "tanh":
        return 1 / math.cosh(z) ** 2
    s = 1 / (1 + math.exp(-z))
    return s + z * s / (1 + math.exp(z))


@pytest.mark.parametrize("number", [0, 1, 2], ids=["gelu", "tanh", "silu"])
def test_slopes_are_those_of_libm(number):
    z = torch.linspace(-30, 30, 4001, dtype=F64)
    one, large = torch.ones(1, dtype=F64), 2.0**700
    layers = Layers([torch.full((1, 1), large, dtype=F64)], [torch.zeros(1, dtype=F64)], one, one[:, None])
    flow = SteadyFlow(lambda x, _: x, layers, EULER, number)
    got = flow((z / large)[:, None], 1.0)[:, 0]
    expected = torch.tensor([slope(("gelu", "tanh", "silu")[number], float(t)) for t in z], dtype=F64)
    assert float((got - expected).abs().max()) < 1e-15
    below = (z < -3.0) & (
        z > -25.0
    )  # where GELU is no smaller than the state, and its slope has lost few digits
    assert float((got / expected - 1)[below].abs().max()) < 1e-13


@pytest.mark.usefixtures("two")
def test_a_member_does_not_depend_on_the_others_and_the_lost_stay_alone():
    flow, x = steady(dynamics()), states(PART + 21)
    lengths = 0.1 + torch.rand(len(x), generator=generator(3), dtype=F64)
    whole = flow(x, lengths)
    for part in (slice(0, 1), slice(5, 22), slice(PART - 3, None)):
        assert torch.equal(flow(x[part], lengths[part]), whole[part])
    lost = x.clone()
    lost[3], lost[7, 2], lost[11] = torch.nan, torch.inf, -1e200
    got, others = flow(lost, lengths), [k for k in range(len(x)) if k not in (3, 7, 11)]
    assert torch.equal(got[others], whole[others])
    assert not bool(got[3].isfinite().any())
    assert not bool(got[7].isfinite().all())


def test_what_wants_derivatives_asks_the_flow_itself():
    flow, x = dynamics(), states(5)
    asked = x.clone().requires_grad_()
    found = steady(flow)(asked, 0.1)
    assert found.requires_grad
    length = torch.full((5,), 0.1, dtype=F64, requires_grad=True)
    assert steady(flow)(x, length).requires_grad
    with torch.no_grad():
        assert not steady(flow)(asked, 0.1).requires_grad
    mapped = vmap(lambda x: steady(flow)(x, 0.1))(x[None])[0]
    close(mapped - x, flow(x, 0.1) - x, 1e-14)
    close(steady(flow)(x.T.contiguous().T, 0.1), flow(x, 0.1), 1e-14)
    with pytest.raises(RuntimeError):  # states of another size, of which the flow itself complains
        steady(flow)(states(5, dof=2), 0.1)
    assert steady(flow)(x[:0], 0.1).shape == (0, 6)


def test_flows_without_such_a_network_come_back_as_they_are(monkeypatch):
    assert steady(torch.add) is torch.add
    for flow in (dynamics("sine"), dynamics(hamiltonian="separable"), dynamics(integrator="gl4")):
        assert steady(flow) is flow
    single = dynamics().float()
    assert steady(single) is single
    monkeypatch.setattr(room, "library", lambda: None)
    flow = dynamics()
    assert steady(flow) is flow


def test_a_rollout_begins_with_what_the_parameters_are_then():
    flow, x = dynamics(), states(4)
    before = rollout(flow, x, 0.1, 4)
    flow.field.network.output.weight.mul_(2.0)
    after = rollout(flow, x, 0.1, 4)
    expected = x
    for k in range(1, 4):
        expected = flow(expected, 0.1)
        close(after[:, k], expected, 1e-14)
    assert not torch.equal(before, after)
