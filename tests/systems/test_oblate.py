"""The exact flow in C is that of the formulas to rounding, and the formulas where derivatives are wanted."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.compiled_libraries import PART
from ahnn.systems import Molniya, oblate
from ahnn.systems.truth import SubstepsFlow, accurate_substeps, exact_flow

F64 = torch.float64


@pytest.fixture(params=[1.0, 250.0])
def molniya(request):
    """Satellites of some mass."""
    return Molniya(name="molniya", dt=60.0, steps=1440, mass=request.param)


def along(flow, x, dt, steps):
    for _ in range(steps):
        x = flow(x, dt)
    return x


@pytest.mark.parametrize("dt", [60.0, -60.0, 0.5, 200.0])
def test_it_is_the_composition_to_rounding(molniya, dt):
    x, plain = molniya.initial_states(45, generator(0)), SubstepsFlow(molniya, accurate_substeps(molniya))
    fast = exact_flow(molniya)
    assert isinstance(fast, oblate.OblateFlow)
    q, p = (along(fast, x, dt, 20) - along(plain, x, dt, 20)).chunk(2, dim=-1)
    assert float(q.abs().max()) < 1e-9
    assert float(p.abs().max()) < 1e-12 * molniya.mass


def test_each_state_may_have_a_step_of_its_own(molniya):
    x, plain = (
        molniya.initial_states(PART + 21, generator(1)),
        SubstepsFlow(molniya, accurate_substeps(molniya)),
    )
    dt = 10 + 50 * torch.rand(len(x), generator=generator(2), dtype=F64)
    fast = exact_flow(molniya)
    close(fast(x, dt) - x, plain(x, dt) - x, 1e-12)
    for part in (slice(0, 1), slice(5, 40), slice(PART - 3, None)):
        assert torch.equal(fast(x[part], dt[part]), fast(x, dt)[part])


def test_energy_stays_on_a_whole_orbit(molniya):
    x = molniya.initial_states(8, generator(3))
    close(molniya.energy(along(exact_flow(molniya), x, molniya.dt, 700)), molniya.energy(x), 1e-11)


def test_derivatives_and_other_numbers_take_the_formulas(molniya):
    x, fast = molniya.initial_states(3, generator(4)), exact_flow(molniya)
    x.requires_grad_()
    fast(x, 60.0).sum().backward()
    assert bool((x.grad != 0).all())
    single = fast(x.detach().float(), 60.0)
    assert single.dtype == torch.float32
    assert fast(x.detach()[None], 60.0).shape == (1, 3, 6)


def test_without_a_compiler_it_is_the_formulas(molniya, monkeypatch):
    x, fast = molniya.initial_states(3, generator(5)), exact_flow(molniya)
    monkeypatch.setattr(oblate, "library", lambda: None)
    assert torch.equal(fast(x, 60.0), SubstepsFlow(molniya, accurate_substeps(molniya))(x, 60.0))


def test_a_state_that_is_not_finite_leaves_the_others_alone(molniya):
    x, fast = molniya.initial_states(5, generator(6)), exact_flow(molniya)
    spoilt = x.clone()
    spoilt[2] = torch.nan
    others = torch.tensor([0, 1, 3, 4])
    assert torch.equal(fast(spoilt, 60.0)[others], fast(x, 60.0)[others])
    assert bool(fast(spoilt, 60.0)[2].isnan().all())
