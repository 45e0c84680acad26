"""A learned field is J grad H of its own learned energy, in every mode that Lightning evaluates in."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import MOLNIYA, SPRING, TINY, close, data_module, generator, random_states

from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.hamiltonians import make_hamiltonian
from ahnn.dynamics.networks import Perceptron
from ahnn.errors import UserError

STRUCTURES = ["generic", "separable", "mechanical", "central_body"]
INPUTS = ["cartesian", "isotropic"]


@pytest.fixture(scope="module")
def statistics(cache):
    wide = dataclasses.replace(MOLNIYA, raan=(0.0, 360.0))
    return data_module(wide, cache, steps=200).statistics()


def learned(structure, inputs, statistics, **changes):
    torch.manual_seed(1)
    options = {"mass": 2.0, "mu": None, "scaling": "minmax", "network": TINY} | changes
    field = make_hamiltonian(structure, 3, inputs=inputs, **options).double()
    with torch.no_grad():
        field.fit(statistics)
    return field


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("depth", [1, 2, 4])
def test_the_closed_form_gradient_equals_autograd(activation, depth):
    torch.manual_seed(depth)
    network = Perceptron(3, 1, width=9, depth=depth, activation=activation).double()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter)
    z = 3 * torch.randn(40, 3, generator=generator(2), dtype=torch.float64)
    z.requires_grad_()
    (expected,) = torch.autograd.grad(network(z).sum(), z)
    close(network.gradient(z), expected, 1e-10)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_gradients_of_the_gradient_are_right(activation):
    torch.manual_seed(0)
    network = Perceptron(2, 1, width=3, depth=2, activation=activation).double()
    z = torch.randn(2, 2, generator=generator(3), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(network.gradient, (z,))
    assert torch.autograd.gradgradcheck(network.gradient, (z,))


@pytest.mark.parametrize("inputs", INPUTS)
@pytest.mark.parametrize(
    ("structure", "falloff"), [*((s, 0.0) for s in STRUCTURES), ("mechanical", 1.5), ("central_body", 3.0)]
)
def test_the_field_is_j_grad_of_the_energy(structure, falloff, inputs, statistics):
    field = learned(structure, inputs, statistics, falloff=falloff)
    x = random_states(MOLNIYA, 30, seed=4).requires_grad_()
    (gradient,) = torch.autograd.grad(field.energy(x).sum(), x)
    of_q, of_p = gradient.chunk(2, dim=-1)
    got_q, got_p = field(x).chunk(2, dim=-1)
    close(got_q, of_p, 1e-10)
    close(got_p, -of_q, 1e-10)
    if structure != "generic":
        q, p = x.chunk(2, dim=-1)
        assert torch.equal(field.velocity(p), got_q)
        assert torch.equal(field.force(q), got_p)


@pytest.mark.parametrize("inputs", INPUTS)
@pytest.mark.parametrize("structure", STRUCTURES)
def test_the_field_is_the_same_under_no_grad_and_inference_mode(structure, inputs, statistics):
    field = learned(structure, inputs, statistics)
    x = random_states(MOLNIYA, 5, seed=5)
    expected = field(x)
    assert expected.requires_grad
    with torch.no_grad():
        assert torch.equal(field(x), expected)
    with torch.inference_mode():
        assert torch.equal(field(x.clone()), expected)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_weights_receive_correct_gradients_through_the_field(structure, statistics):
    field = learned(structure, "isotropic", statistics)
    x = random_states(MOLNIYA, 2, seed=6)
    names, values = zip(*field.named_parameters(), strict=True)
    size = field(x).detach().abs().amax(0)

    def call(*weights):
        named = dict(zip(names, weights, strict=True))
        return torch.func.functional_call(field, named, (x,)) / size

    assert torch.autograd.gradcheck(call, tuple(v.detach().requires_grad_() for v in values), atol=1e-6)


def test_isotropic_inputs_are_direction_and_log_distance(statistics):
    field = learned("mechanical", "isotropic", statistics)
    inputs = field.potential.inputs
    r = statistics.radius
    q = torch.tensor([[0.0, 3.0, 4.0]], dtype=torch.float64) / 5
    z = inputs(torch.cat((q * r[0], q * r[1])))
    close(z[:, :3], q.expand(2, 3), 1e-15)
    close(z[:, 3], torch.tensor([-1.0, 1.0]), 1e-12)


def test_a_known_central_body_is_exact_whatever_the_precision(statistics):
    """The logarithm of mu in float32 would move it by up to 5e-7, which costs as much as the floor."""
    for dtype in (torch.float64, torch.float32):
        field = learned("central_body", "isotropic", statistics, mass=1.0, mu=MOLNIYA.mu).to(dtype).double()
        field.potential.remainder.unit.zero_()
        q = random_states(MOLNIYA, 10, seed=7)[:, :3]
        close(field.force(q), -MOLNIYA.mu * q / q.norm(dim=-1, keepdim=True) ** 3, 1e-14)


def test_a_learned_central_body_begins_with_the_fitted_mu(statistics):
    field = learned("central_body", "isotropic", statistics, mass=1.0)
    assert float(field.potential.mu.detach()) == pytest.approx(MOLNIYA.mu, rel=0.02)


def test_a_central_body_may_be_in_a_plane_and_not_on_a_line():
    options = {"mass": 1.0, "scaling": "block", "network": TINY, "inputs": "cartesian", "falloff": 3.0}
    plane = make_hamiltonian("central_body", 2, mu=2.0, **options).double()
    plane.potential.remainder.unit.zero_()
    close(plane.force(torch.tensor([[3.0, 4.0]])), torch.tensor([[-6.0, -8.0]]) / 125, 1e-12)
    with pytest.raises(UserError, match="expected at least 2 degrees of freedom; received 1"):
        make_hamiltonian("central_body", 1, mu=2.0, **options)


@pytest.mark.parametrize("mu", [0.0, -1.0, float("nan"), float("inf")])
def test_a_central_body_of_no_attraction_is_refused(mu):
    options = {"mass": 1.0, "scaling": "block", "network": TINY, "inputs": "cartesian"}
    with pytest.raises(UserError, match=str(mu)):
        make_hamiltonian("central_body", 3, mu=mu, **options)


@pytest.mark.parametrize("falloff", [1.0, 3.0])
def test_a_learned_potential_falls_with_a_power_of_the_distance(falloff, statistics):
    """On a ray the inputs that say the direction are constant; without those of the distance N is, too."""
    field = learned("mechanical", "isotropic", statistics, falloff=falloff)
    potential = field.potential
    with torch.no_grad():
        potential.network.hidden[0].weight[:, -1] = 0.0
        potential.network.output.bias.fill_(0.3)
    q = random_states(MOLNIYA, 10, seed=8)[:, :3]
    close(potential(2.0 * q), potential(q) / 2.0**falloff, 1e-12)
    low = statistics.radius[0] * q / q.norm(dim=-1, keepdim=True)
    close(potential(low), potential.unit * potential.network(potential.inputs(low)).squeeze(-1), 1e-12)


@pytest.mark.parametrize(
    ("structure", "dof", "falloff", "said"),
    [
        ("generic", 2, 1.0, "generic has no V"),
        ("mechanical", 1, 1.0, "one dimension"),
        ("mechanical", 2, -1.0, "-1"),
    ],
)
def test_a_fall_without_a_distance_is_refused(structure, dof, falloff, said):
    options = {"mass": 1.0, "mu": None, "scaling": "block", "network": TINY, "inputs": "cartesian"}
    with pytest.raises(UserError, match=said):
        make_hamiltonian(structure, dof, falloff=falloff, **options)


def test_impossible_structures_and_inputs_are_refused_by_name(cache):
    options = {"mass": 1.0, "mu": None, "scaling": "block", "network": TINY}
    with pytest.raises(UserError, match="received 'generics'"):
        make_hamiltonian("generics", 1, inputs="cartesian", **options)
    with pytest.raises(UserError, match="received 'polar'"):
        make_hamiltonian("generic", 2, inputs="polar", **options)
    with pytest.raises(UserError, match="at least 2 degrees of freedom; received 1"):
        make_hamiltonian("generic", 1, inputs="isotropic", **options)
    with pytest.raises(UserError, match="mechanical has no central body"):
        make_hamiltonian("mechanical", 2, inputs="cartesian", **(options | {"mu": 3.0}))
    data = data_module(dataclasses.replace(SPRING, q0=(0.0, 0.0), p0=(0.0, 0.0)), cache)
    with pytest.raises(UserError, match="vary over the training split"):
        make_hamiltonian("generic", 1, inputs="cartesian", **options).fit(data.statistics())


@pytest.mark.parametrize(
    "options",
    [
        TINY | {"activation": "relu"},
        TINY | {"width": 0},
        TINY | {"depth": 0},
        TINY | {"width": 2.5},
        TINY | {"dropout": 0.1},
    ],
)
def test_impossible_networks_are_refused_with_what_came(options):
    (wrong,) = {k: v for k, v in options.items() if TINY.get(k) != v}.items()
    with pytest.raises(UserError, match=f"{wrong[0]}.*{'' if wrong[0] == 'dropout' else wrong[1]}"):
        make_hamiltonian(
            "generic", 1, mass=1.0, mu=None, inputs="cartesian", scaling="block", network=options
        )
