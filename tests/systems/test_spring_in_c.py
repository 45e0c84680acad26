"""The exact flow of a spring in C has the bits of the formulas, which replace it where it cannot be used."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import generator

from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4
from ahnn.systems import MassSpring, spring_steps
from ahnn.systems.truth import SubstepsFlow, exact_flow

F64 = torch.float64
SPRING = MassSpring(name="spring", dt=0.1, steps=40, mass=1.7)


def flows(system, count):
    plain = SubstepsFlow(system, count)
    return plain, system.compiled(plain, system.dt / count)


def drawn(count, seed=0):
    """States of all sizes, and those on an axis, (count + 4, 2)."""
    x = torch.randn(count, 2, generator=generator(seed), dtype=F64)
    edges = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0], [1e-300, 1e5]], dtype=F64)
    return torch.cat((x * 10.0 ** torch.arange(count, dtype=F64).remainder(9).sub(4).unsqueeze(1), edges))


@pytest.mark.parametrize("mass", [1.0, 0.3, 250.0])
@pytest.mark.parametrize("stiffness", [5.0, 0.13])
@pytest.mark.parametrize(("dt", "count"), [(0.01, 1), (0.1, 3), (-0.1, 1), (0.25, 2)])
def test_it_has_the_bits_of_the_formulas(mass, stiffness, dt, count):
    system = dataclasses.replace(SPRING, mass=mass, stiffness=stiffness, dt=abs(dt))
    (plain, fast), x = flows(system, count), drawn(40)
    assert isinstance(fast, spring_steps.SpringFlow)
    assert spring_steps.library() is not None
    for _ in range(3):
        assert torch.equal(fast(x, dt), plain(x, dt))
        x = plain(x, dt)


def test_it_is_used_without_the_formulas(monkeypatch):
    _, fast = flows(SPRING, 2)
    monkeypatch.setattr(GaussLegendre4, "increment", lambda *_: pytest.fail("a sweep in Python"))
    assert bool(fast(drawn(3), 0.1).isfinite().all())


def test_stages_that_do_not_converge_are_refused_with_the_same_message():
    said = []
    for flow in flows(dataclasses.replace(SPRING, stiffness=1e6), 1):
        with pytest.raises(UserError, match=r"gl4: the stages of 6 of 7 states did not converge") as refused:
            flow(drawn(3), 0.1)
        said.append(str(refused.value))
    assert said[0] == said[1]


def test_other_steps_and_numbers_take_the_formulas():
    plain, fast = flows(SPRING, 2)
    x, each = drawn(5), 0.01 * torch.arange(1, 10, dtype=F64)
    assert torch.equal(fast(x, each), plain(x, each))
    assert torch.equal(fast(x, each[3]), plain(x, each[3]))
    assert torch.equal(fast(x.float(), 0.1), plain(x.float(), 0.1))
    graph = x.clone().requires_grad_()
    fast(graph, 0.1).sum().backward()
    assert bool((graph.grad != 0).all())
    strided = torch.stack((x, 2 * x), dim=-1)[..., 0]
    assert torch.equal(fast(strided, 0.1), plain(x, 0.1))


def test_a_state_that_is_not_finite_leaves_the_others_alone():
    x, (plain, fast) = drawn(5), flows(SPRING, 2)
    x[2] = torch.nan
    assert torch.equal(fast(x, 0.1).nan_to_num(7.0), plain(x, 0.1).nan_to_num(7.0))
    assert bool(fast(x, 0.1)[2].isnan().all())


def test_other_equations_and_a_machine_without_a_compiler_take_the_formulas(monkeypatch):
    class Hard(MassSpring):
        def force(self, q):
            return -self.stiffness * q**3

    assert isinstance(exact_flow(Hard(name="hard", dt=0.01, steps=10)), SubstepsFlow)
    plain, fast = flows(SPRING, 2)
    monkeypatch.setattr(spring_steps, "library", lambda: None)
    assert torch.equal(fast(drawn(3), 0.1), plain(drawn(3), 0.1))
