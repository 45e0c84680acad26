"""Phases of a motion: disjoint, complete, and where they are said to be."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.generate import generate
from ahnn.systems import Kepler, MassSpring, Molniya

SYSTEMS = [MassSpring(name="spring", dt=0.1, steps=50), Kepler(name="kepler", dt=0.1, steps=50)]


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_thirds_by_the_size_of_the_force(system):
    x = generate(system, 20, seed=0).states
    phases = system.phases(x)
    assert bool((sum(part.long() for part in phases.values()) == 1).all())
    assert [float(part.double().mean()) for part in phases.values()] == pytest.approx([1 / 3] * 3, abs=0.01)
    force = system.force(x.chunk(2, dim=-1)[0]).norm(dim=-1)
    weak, medium, strong = (force[part] for part in phases.values())
    assert weak.max() < medium.min() <= medium.max() < strong.min()


def test_an_orbit_is_near_or_far_and_a_state_that_is_absent_is_neither():
    system = Molniya(name="m", dt=60.0, steps=10)
    x = torch.zeros(3, 6, dtype=torch.float64)
    x[:, 1] = torch.tensor([1.9, 2.1, torch.nan]) * system.r_eq
    near, far = system.phases(x).values()
    assert near.tolist() == [True, False, False]
    assert far.tolist() == [False, True, False]
