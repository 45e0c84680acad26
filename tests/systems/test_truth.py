"""Generated trajectories agree with closed forms, Taylor-series orbits and conserved energies."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, close

from ahnn.data.generate import generate
from ahnn.integrators import INTEGRATORS
from ahnn.systems.orbits import period

FIXTURE = Path(__file__).parents[1] / "fixtures" / "j2_orbits.csv"


def reference_orbits():
    """Times (K,) and states (orbits, K, 6) of the fixture: heyoka, Taylor series, tolerance 1e-18."""
    lines = [line for line in FIXTURE.read_text().splitlines() if not line.startswith("#")]
    rows = torch.tensor([[float(v) for v in row] for row in list(csv.reader(lines))[1:]], dtype=torch.float64)
    rows = rows.view(5, -1, rows.shape[1])
    return rows[0, :, 1].long(), rows[:, :, 2:8]


def a_day(name):
    """States of the fixture's orbits every 60 s for a day, shape (5, 1441, 6)."""
    _, states = reference_orbits()
    x = states[:, 0]
    trajectory = [x]
    for _ in range(1440):
        x = INTEGRATORS[name].step(MOLNIYA, x, 60.0)
        trajectory.append(x)
    return torch.stack(trajectory, 1)


def test_kahan_li8_orbits_agree_with_taylor_series_and_keep_their_energy():
    times, expected = reference_orbits()
    orbits = a_day("kahan_li8")
    difference = orbits[:, times // 60] - expected
    assert float(difference[..., :3].norm(dim=-1).max()) < 1e-6  # km
    assert float(difference[..., 3:].norm(dim=-1).max()) < 1e-9  # km/s
    energy = MOLNIYA.energy(orbits)
    assert float((energy / energy[:, :1] - 1).abs().max()) < 1e-12


def test_the_spring_agrees_with_its_closed_form():
    system = dataclasses.replace(SPRING, mass=2.0)
    states = generate(system, 20, seed=1).states
    omega = (system.stiffness / system.mass) ** 0.5
    t = torch.arange(system.steps + 1, dtype=torch.float64) * system.dt
    q0, p0 = (states[:, :1, i] for i in (0, 1))
    cos, sin = (omega * t).cos(), (omega * t).sin()
    m = system.mass
    exact = torch.stack((q0 * cos + p0 / (m * omega) * sin, p0 * cos - m * omega * q0 * sin), dim=-1)
    close(states, exact, 2e-8)  # the method's own error, 1.02e-8 at k/m = 5
    energy = system.energy(states)
    assert float((energy / energy[:, :1] - 1).abs().max()) < 1e-12


@pytest.mark.parametrize("name", ["kepler", "pendulum", "henon_heiles"])
def test_generated_trajectories_keep_their_energy(name):
    system = SYSTEMS[name]
    energy = system.energy(generate(system, 10, seed=2).states)
    drift = (energy - energy[:, :1]).abs().amax(1)
    assert float((drift / energy[:, 0].abs()).max()) < 1e-8


def test_generation_depends_on_the_seed_alone():
    system = dataclasses.replace(SPRING, steps=20)
    first, again, other = (generate(system, 8, seed).states for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_two_periods_give_ragged_trajectories_with_nan_beyond_their_end():
    system = dataclasses.replace(MOLNIYA, periods=2.0, steps=1, dt=600.0)
    data = generate(system, 6, seed=0)
    expected = torch.ceil(2 * period(data.states[:, 0], system.mu, 1.0) / 600.0).long() + 1
    lengths = data.present.sum(1)
    assert torch.equal(lengths, expected)
    assert len(set(lengths.tolist())) > 1
    assert data.states.shape == (6, int(lengths.max()), 6)
    for states, length in zip(data.states, lengths, strict=True):
        assert bool(states[:length].isfinite().all())
        assert bool(states[length:].isnan().all())
        r = states[:length, :3].norm(dim=-1)
        assert float(r[-1] / r[0]) < 1.5  # back near periapsis after two revolutions
