"""The truth is as accurate as it says, in as many substeps as that takes, or is refused."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, close

from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.systems import truth
from ahnn.systems.truth import ACCURACY, accurate_substeps, exact_flow


@pytest.mark.parametrize("dt", [pytest.param(0.01, marks=pytest.mark.slow), 0.05, 0.1])
@pytest.mark.sampled(2)
def test_the_truth_of_a_spring_is_its_closed_form(dt):
    system = dataclasses.replace(SPRING, dt=dt, steps=round(10 / dt))
    states, times, *_ = generate(system, 20, 3)
    omega = math.sqrt(system.stiffness / system.mass)
    q, p = states[:, :1, 0], states[:, :1, 1]
    phase = omega * times
    exact = q * phase.cos() + p / omega * phase.sin()
    assert float((states[..., 0] - exact).abs().max()) < 3 * ACCURACY * float(exact.abs().max())
    assert accurate_substeps(system) > 1


@pytest.mark.parametrize("dt", [300.0, 1200.0])
def test_coarse_samples_of_an_orbit_are_those_of_fine_ones(dt):
    coarse = dataclasses.replace(MOLNIYA, dt=dt, steps=round(86400 / dt))
    states = generate(coarse, 4, 0).states
    fine = generate(MOLNIYA, 4, 0).states[:, :: round(dt / 60)]
    close(states[..., :3], fine[..., :3], 3 * ACCURACY)


def test_a_step_that_no_substeps_save_is_refused(monkeypatch):
    monkeypatch.setattr(truth, "FINEST", 8)  # 64 are as hopeless
    system = dataclasses.replace(MOLNIYA, dt=1e6, steps=10)
    with pytest.raises(
        UserError, match=r"molniya: expected reference states .*received dt=1e\+06.*Shorten system.dt"
    ):
        generate(system, 4, 0)


@pytest.mark.parametrize("name", ["kepler", "heavy_spring", "henon_heiles", "pendulum"])
def test_the_flow_takes_steps_of_any_length_for_each_member(name):
    system = SYSTEMS[name]
    x = system.initial_states(3, torch.Generator().manual_seed(1))
    flow = exact_flow(system)
    steps = torch.tensor([0.5, 1.0, 7.0], dtype=torch.float64) * system.dt
    together = flow(x, steps)
    apart = torch.cat([flow(x[b : b + 1], float(steps[b])) for b in range(3)])
    close(together, apart, 1e-9)
    close(flow(flow(x, system.dt), -system.dt), x, 1e-9)
