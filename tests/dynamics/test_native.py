"""Steps in C are those of `written_out` in float64, forwards and back, to the rounding of their numbers."""

from __future__ import annotations

import copy
from contextlib import contextmanager, nullcontext

import pytest
import torch
from helpers import generator
from test_fused_steps import dynamics as narrow
from test_fused_steps import inputs_of
from torch.func import functional_call, jvp
from torch.fx.experimental.proxy_tensor import make_fx

from ahnn.dynamics import HamiltonianDynamics, native
from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.fused_steps import Scheme, network_gradient, step
from ahnn.integrators import INTEGRATORS
from ahnn.integrators.base import column
from ahnn.integrators.tableaus import EULER

pytestmark = pytest.mark.skipif(native.library() is None, reason="needs a C compiler")
NAMES = ("gelu", "tanh", "silu")
EXPLICIT = [name for name, method in INTEGRATORS.items() if hasattr(method, "tableau")]


def dynamics(activation="gelu", method="rk4", dtype=torch.float32, **sizes) -> HamiltonianDynamics:
    return narrow(activation, method, dtype=dtype, **{"width": 13, "depth": 2} | sizes)


def numbers(*shape, seed=1):
    return torch.randn(*shape, generator=generator(seed))


@contextmanager
def single_operations():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "library", lambda _: None)
        yield


def gradients(own, x, v, dt):
    """The increment, its reverse with v for x and parameters, and the type of the node."""
    x = x.clone().requires_grad_()
    value = own.increment(x, dt)
    return [value, *torch.autograd.grad(value, [x, *inputs_of(own)], v)], value.grad_fn


def near(found, expected, tolerance=5e-6, dtype=torch.float32):
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == dtype
        one, other = one.detach().double(), other.detach()
        assert float((one - other).norm()) <= tolerance * float(other.norm())


def compared(own, x, v, dt):
    exact = dt.double() if isinstance(dt, torch.Tensor) else dt
    wide, many, pull = copy.deepcopy(own).double(), x.double(), v.double()
    with single_operations():
        expected = gradients(wide, many, pull, exact)[0]
    for found, node in (gradients(own, x, v, dt), gradients(wide, many, pull, exact)):
        assert node.native
        double = found[0].dtype == torch.float64
        near(found, expected, 1e-13 if double else 5e-6, found[0].dtype)


@pytest.mark.parametrize("activation", NAMES)
@pytest.mark.parametrize(
    ("width", "depth", "dof", "batch"), [(13, 2, 2, 37), (64, 3, 3, 5), (3, 1, 1, 1), (7, 2, 20, 70)]
)
def test_increments_and_gradients_are_those_of_single_operations(activation, width, depth, dof, batch):
    own = dynamics(activation, width=width, depth=depth, dof=dof)
    compared(own, numbers(batch, 2 * dof), numbers(batch, 2 * dof, seed=2), 0.2)


@pytest.mark.parametrize("method", EXPLICIT)
def test_every_explicit_method_has_a_step_for_each_member(method):
    own, x, v = dynamics(method=method), numbers(21, 4), numbers(21, 4, seed=2)
    compared(own, x, v, 0.1)
    compared(own, x, v, 0.1 * torch.rand(21, generator=generator(3)))


@pytest.mark.usefixtures("two")
def test_parts_add_up(monkeypatch):
    monkeypatch.setattr(native, "PART", 16)
    compared(dynamics(), numbers(70, 4), numbers(70, 4, seed=2), 0.2)
    compared(dynamics(), numbers(70, 4), numbers(70, 4, seed=2), torch.rand(70, generator=generator(3)))


def test_what_is_kept_changes_no_bit_and_serves_once(monkeypatch):
    own, x, v = dynamics(), numbers(70, 4).requires_grad_(), numbers(70, 4, seed=2)
    asked, found = [x, *own.field.network.hidden.parameters()], []
    for most in (native.KEPT, 0):
        monkeypatch.setattr(native, "KEPT", most)
        value = own.increment(x, 0.2)
        found += [torch.autograd.grad(value, asked, v, retain_graph=again) for again in (True, False)]
    for other in found[1:]:
        assert all(map(torch.equal, found[0], other))


@pytest.mark.parametrize("name", NAMES)
def test_the_network_gradient_holds_far_from_the_origin_too(name):
    activation = ACTIVATIONS[name]
    layers = dynamics(name).field.network.layers()
    x = 20 * numbers(200, 4).requires_grad_()
    found, expected = [], []
    double = []
    for dtype, to in ((torch.float32, found), (torch.float64, double), (torch.float64, expected)):
        asked = x.detach().to(dtype).requires_grad_()
        wide = layers._replace(
            weights=[w.to(dtype) for w in layers.weights],
            biases=[b.to(dtype) for b in layers.biases],
            last=layers.last.to(dtype),
            leave=layers.leave.to(dtype),
        )
        with single_operations() if to is expected else nullcontext():
            value = network_gradient(asked, wide, activation)
            to += [value, *torch.autograd.grad(value, asked, numbers(200, 4, seed=2).to(dtype))]
    near(found, expected, 2e-5)
    near(double, expected, 1e-13, torch.float64)


def test_gradients_of_gradients_and_of_several_cotangents_are_those_of_autograd():
    own, x, v = dynamics(), numbers(9, 4).requires_grad_(), numbers(3, 9, 4, seed=2)
    wide, far = copy.deepcopy(own).double(), x.detach().double().requires_grad_()
    many, linked = [], []
    for flow, at, by in ((own, x, v), (wide, far, v.double())):
        weight = flow.field.network.hidden[1].weight
        many.append(torch.autograd.grad(flow.increment(at, 0.2), (at, weight), by, is_grads_batched=True))
        first = torch.autograd.grad(flow.increment(at, 0.2), (at, weight), by[0], create_graph=True)
        linked.append(torch.autograd.grad(sum(t.square().sum() for t in first), (at, weight)))
    near(*many)
    near(*linked)


@pytest.mark.filterwarnings("ignore:.*torch.jit.script")  # torch's own, of jvp
def test_what_follows_single_operations_sees_them():
    own, x, v = dynamics(), numbers(9, 4), numbers(9, 4, seed=2)
    wide = copy.deepcopy(own).double()
    graph = make_fx(lambda x: own.increment(x, 0.2))(x)
    other = numbers(9, 4, seed=5)
    near([graph(other)], [wide.increment(other.double(), 0.2)])
    with torch.no_grad():
        tangent = jvp(lambda x: own.increment(x, 0.2), (x,), (v,))[1]
        exact = jvp(lambda x: wide.increment(x, 0.2), (x.double(),), (v.double(),))[1]
    near([tangent], [exact])
    parameters = {name: p.detach() for name, p in own.named_parameters()}
    near([functional_call(own.field, {k[6:]: p for k, p in parameters.items()}, x)], [wide.field(x.double())])


def test_a_lost_member_stays_alone():
    own, x = dynamics(), numbers(70, 4)
    lost = x.clone()
    lost[3], lost[7, 2] = torch.nan, torch.inf
    with torch.no_grad():
        whole, found = own.increment(x, 0.2), own.increment(lost, 0.2)
    others = [k for k in range(70) if k not in (3, 7)]
    assert torch.equal(found[others], whole[others])
    assert not bool(found[3].isfinite().any())
    assert not bool(found[7].isfinite().all())


def test_other_tensors_take_single_operations(monkeypatch):
    own, x, v = dynamics(), numbers(9, 4), numbers(9, 4, seed=2)
    compared(own, numbers(4, 9).T, v, 0.2)  # not contiguous
    empty = gradients(own, x[:0], v[:0], 0.2)[0]
    assert empty[0].shape == (0, 4)
    assert not any(bool(t.any()) for t in empty)
    assert not gradients(dynamics("sine"), x, v, 0.2)[1].native
    layers, tanh = own.field.layers(x), ACTIVATIONS["tanh"]
    with pytest.raises(RuntimeError):  # states of another size: torch says so
        step(numbers(9, 3), layers, Scheme(EULER, 1.0, tanh))
    with pytest.raises(RuntimeError):  # steps of other states
        step(x, layers, Scheme(EULER, column(torch.ones(5)), tanh))
    inside = gradients(own, x, v, 0.2)[0]
    monkeypatch.setattr(native, "library", lambda _: None)
    without, node = gradients(own, x, v, 0.2)
    assert not node.native
    near(inside, [t.double() for t in without])


def test_a_training_in_c_is_known_beforehand(monkeypatch):
    assert dynamics().in_c()
    assert dynamics().double().in_c()
    others = dynamics("sine"), dynamics().bfloat16(), dynamics(method="gl4")
    assert not any(own.in_c() for own in others)
    monkeypatch.setattr(native, "library", lambda _: None)
    assert not dynamics().in_c()


def test_a_parameter_that_changed_in_between_is_noticed():
    own, x = dynamics(), numbers(9, 4)
    value = own.increment(x, 0.2).sum()
    with torch.no_grad():
        own.field.network.hidden[1].weight.mul_(2)
    with pytest.raises(RuntimeError, match="inplace"):
        value.backward()


def test_a_default_device_is_that_of_others():
    native.table.cache_clear()
    own, x, v = dynamics(), numbers(9, 4), numbers(9, 4, seed=2)
    before = gradients(own, x, v, 0.2)[0]
    native.table.cache_clear()
    with torch.device("meta"):
        assert all(map(torch.equal, before, gradients(own, x, v, 0.2)[0]))


def test_tensors_that_stand_for_others_are_not_read():
    own, x = dynamics(), numbers(9, 4)
    wide = copy.deepcopy(own).double()
    with torch.no_grad():
        near([own.increment(torch._neg_view(x), 0.2)], [wide.increment(-x.double(), 0.2)])
    assert not native.plain(torch._efficientzerotensor((9, 4)), torch.float32)
