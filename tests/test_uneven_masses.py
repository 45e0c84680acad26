"""Masses of 1e-3 and 1e3, whose energies are six decades apart, are learned by what is taken by default."""

from __future__ import annotations

import pytest
import torch

import ahnn

MASSES = torch.tensor([1e-3, 1e3], dtype=torch.float64)


def swings(count, samples, seed):
    """Oscillators of frequency 1, which do not feel one another, from positions and velocities of size 1."""
    rng = torch.Generator().manual_seed(seed)
    q, v = 2 * torch.rand(2, count, 1, 2, generator=rng, dtype=torch.float64) - 1
    times = torch.arange(samples, dtype=torch.float64) / 10
    cos, sin = times.cos()[:, None], times.sin()[:, None]
    return ahnn.Trajectories(torch.cat((q * cos + v * sin, MASSES * (v * cos - q * sin)), -1), times)


@pytest.mark.slow
def test_masses_of_a_thousandth_and_a_thousand_are_learned_in_every_component(tmp_path):
    space = ahnn.Space("uneven", ("q1", "q2", "p1", "p2"))
    options = ["model=hnn", "plugins=none", "trainer.max_epochs=15"]
    run = ahnn.fit(swings(400, 51, 0), space, options, folder=tmp_path / "run")
    truth = swings(50, 101, 1).states
    off = (run.rollout(truth[:, 0], 100, 0.1) - truth).square().mean((0, 1)).sqrt()
    assert float((off / truth.flatten(0, 1).std(0)).max()) < 0.05
