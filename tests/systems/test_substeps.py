"""How many substeps the truth takes, by an integrator whose error is known in closed form."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest
import torch
from helpers import SPRING

from ahnn.errors import UserError
from ahnn.systems import spring_steps, truth

STEPS = 500
SYSTEM = dataclasses.replace(SPRING, name="drifting", dt=0.5, steps=STEPS)
ONE = torch.ones(2, 2, dtype=torch.float64)


@pytest.fixture
def drifting(monkeypatch):
    """Give a method that is off by rates_q h^2 and rates_p h^2 in a step, and the list of its steps."""

    def install(rate_q, rate_p=0.0):
        steps = []

        def step(system, x, h):
            del system
            steps.append(h)
            rates = torch.tensor([rate_q, rate_p], dtype=torch.float64)
            square = h * h
            return x + rates * (square.unsqueeze(-1) if isinstance(square, torch.Tensor) else square)

        known = {SYSTEM.integrator: SimpleNamespace(step=step)}
        monkeypatch.setattr(truth, "INTEGRATORS", known)
        monkeypatch.setattr(truth, "_KNOWN", {})
        monkeypatch.setattr(spring_steps, "library", lambda: None)
        return steps

    return install


def sizes():
    start = SYSTEM.initial_states(truth.TRIED, torch.Generator().manual_seed(0)).abs()
    return start.amax(0).tolist()


@pytest.mark.parametrize("count", [1, 2, 8, 64])
@pytest.mark.parametrize("block", [0, 1])
def test_the_error_of_a_trial_is_carried_on_to_the_length_of_a_trajectory(drifting, count, block):
    rates = [0.0, 0.0]
    rates[block] = 1e-7
    drifting(*rates)
    # n substeps drift by rate dt^2 / n in each interval, 2n by half as much.
    expected = STEPS * 1e-7 * SYSTEM.dt**2 / (2 * count) / sizes()[block]
    assert truth._trial_error(SYSTEM, count) == pytest.approx(expected, rel=1e-3)


def test_the_worse_of_positions_and_momenta_counts(drifting):
    drifting(1e-7, 4e-7)
    alone = STEPS * 4e-7 * SYSTEM.dt**2 / 2 / sizes()[1]
    assert truth._trial_error(SYSTEM, 1) == pytest.approx(alone, rel=1e-3)


@pytest.mark.parametrize("needed", [1, 2, 16, 64])
def test_the_fewest_substeps_that_are_accurate_are_taken_and_remembered(drifting, needed):
    # Just accurate enough with so many substeps, and not with half of them.
    rate = 0.9 * needed * 2 * truth.ACCURACY * sizes()[0] / (STEPS * SYSTEM.dt**2)
    steps = drifting(rate)
    assert truth.accurate_substeps(SYSTEM) == needed
    tried = len(steps)
    assert truth.accurate_substeps(SYSTEM) == needed
    assert len(steps) == tried
    assert truth.accurate_substeps(dataclasses.replace(SYSTEM, steps=STEPS // 50)) == max(1, needed // 32)


def test_more_than_64_substeps_are_refused(drifting):
    drifting(1.1 * 64 * 2 * truth.ACCURACY * sizes()[0] / (STEPS * SYSTEM.dt**2))
    with pytest.raises(UserError, match=r"drifting: .*for which 64 substeps .* have an error of 1.1e-10"):
        truth.accurate_substeps(SYSTEM)


def test_what_is_not_finite_is_left_to_the_generation(drifting):
    drifting(float("inf"))
    assert truth._trial_error(SYSTEM, 1) == 0.0


@pytest.mark.parametrize(
    ("dt", "count", "parts"),
    [(0.5, 3, 3), (1.25, 3, 8), (-0.5, 4, 4), (0.01, 3, 1), (0.0, 2, 1), (0.1 + 0.2 + 0.2, 6, 6)],
)
def test_other_steps_take_substeps_in_proportion(drifting, dt, count, parts):
    steps = drifting(0.0)
    truth.SubstepsFlow(SYSTEM, count)(ONE, dt)
    assert steps == pytest.approx([dt / parts] * parts)


def test_each_member_takes_substeps_of_its_own_whoever_is_beside_it(drifting):
    steps = drifting(0.0)
    lengths = torch.tensor([0.2, -1.1], dtype=torch.float64)
    truth.SubstepsFlow(SYSTEM, 2)(ONE, lengths)
    assert len(steps) == 5  # ceil(2 * 1.1 / 0.5)
    own = lengths / torch.tensor([1, 5])
    assert all(torch.allclose(h, own) for h in steps)
