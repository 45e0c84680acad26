"""Learned flows in C beside the same flows in torch."""

from __future__ import annotations

import copy
import ctypes
import pickle

import pytest
import torch

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.learned_flow import learned_flow, library
from ahnn.dynamics.transition import transition

F64 = torch.float64


@pytest.fixture(autouse=True)
def _compiled():
    if library() is None:
        pytest.skip("no C compiler")


def dynamics(hamiltonian="mechanical", inputs="isotropic", integrator="rk4", network=(8, 2, "tanh"), **more):
    """Dynamics with random parameters and constants."""
    torch.manual_seed(0)
    width, depth, activation = network
    options = {
        "hamiltonian": hamiltonian,
        "mu": None,
        "inputs": inputs,
        "scaling": "block",
        "inertia": 2.0,
        **more,
    }
    options |= {"network": {"width": width, "depth": depth, "activation": activation}}
    made = make_dynamics("hamiltonian", dof=3, integrator={"name": integrator}, **options)
    made = made.double().requires_grad_(False)
    for constant in made.buffers():
        constant.add_(0.3 * torch.rand_like(constant))
    return made


def states(count):
    """States some way from the origin."""
    x = torch.randn(count, 6, dtype=F64, generator=torch.Generator().manual_seed(1))
    return x + x.sign()


CASES = [
    *({"hamiltonian": name} for name in ("mechanical", "separable", "central_body", "generic")),
    *({"inputs": name} for name in ("cartesian", "radial")),
    *({"inputs": name, "hamiltonian": "generic"} for name in ("cartesian", "radial")),
    *({"integrator": name} for name in ("euler", "midpoint", "dopri5", "dopri8", "leapfrog", "yoshida6")),
    *({"network": shape} for shape in ((1, 1, "tanh"), (7, 1, "gelu"), (21, 3, "silu"), (40, 2, "gelu"))),
    {"hamiltonian": "separable", "integrator": "kahan_li8"},
    *({"falloff": 3.0, "inputs": name} for name in ("cartesian", "isotropic", "radial")),
    {"hamiltonian": "central_body", "mu": 1.7, "falloff": 2.0},
    {"inertia": [1.0, 2.0, 5.0], "inputs": "cartesian"},
]


@pytest.mark.parametrize("options", CASES, ids=str)
@torch.inference_mode()
def test_increments_are_those_of_torch(options):
    flow = dynamics(**options)
    ours = learned_flow(flow)
    for count, dt in ((13, 0.1), (1, 0.3), (37, -0.2)):
        x = states(count)
        expected, found = flow.increment(x, dt), ours(x, dt) - x
        size = expected.abs().amax()
        assert size > 1e-3
        assert float((found - expected).abs().amax()) < 1e-12 * float(size + x.abs().amax())
        assert not torch.equal(ours(x, 2.0 * dt), ours(x, dt))


@torch.inference_mode()
def test_a_state_has_the_same_bits_in_any_company():
    ours, x = learned_flow(dynamics()), states(37)
    together = ours(x, 0.1)
    assert all(torch.equal(ours(x[k : k + 1], 0.1), together[k : k + 1]) for k in range(37))
    assert torch.equal(ours(x.T.contiguous().T, torch.tensor(0.1, dtype=F64)), together)
    broken = x.clone()
    broken[3] = torch.nan
    found = ours(broken, 0.1)
    assert bool(found[3].isnan().all())
    assert torch.equal(found[4:], together[4:])


@torch.inference_mode()
def test_the_function_for_loops_in_c_has_the_same_bits():
    ours, x = learned_flow(dynamics("generic")), states(13)
    compiled, out = ours.as_compiled(), torch.empty(13, 6, dtype=F64)
    kinds = ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p
    function = ctypes.CFUNCTYPE(ctypes.c_long, *kinds)(compiled.function)
    assert function(compiled.about, 13, x.data_ptr(), 0.1, out.data_ptr()) == 0
    assert torch.equal(out, ours(x, 0.1))


def test_what_it_does_not_know_is_left_to_torch():
    others = [
        dynamics(integrator="gl4"),
        dynamics(network=(8, 2, "sine")),
        dynamics(inputs="angles", angular=[True, False, False]),
        dynamics("mass_matrix", "cartesian"),
        dynamics().float(),
        torch.add,
    ]
    assert [learned_flow(other) for other in others] == [None] * len(others)


def test_gradients_and_steps_of_members_are_those_of_torch():
    flow = dynamics()
    ours, x = learned_flow(flow), states(5).requires_grad_()
    ours(x, 0.1).sum().backward()
    slope = x.grad.clone()
    x.grad = None
    flow(x, 0.1).sum().backward()
    assert torch.equal(slope, x.grad)
    steps = torch.linspace(0.1, 0.5, 5, dtype=F64)
    with torch.no_grad():
        assert torch.equal(ours(x, steps), flow(x, steps))
        pairs = zip(ours.transition(x, 0.1), transition(flow, x, 0.1), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)


@torch.inference_mode()
def test_copies_have_constants_of_their_own():
    ours, x = learned_flow(dynamics()), states(5)
    expected = ours(x, 0.1)
    others = copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))
    del ours
    assert all(torch.equal(other(x, 0.1), expected) for other in others)
