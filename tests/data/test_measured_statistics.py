"""Statistics of noisy measurements: forces are told only where a polynomial follows the motion."""

from __future__ import annotations

import pytest
import torch
from helpers import TINY, close, generator

from ahnn.data.measured_statistics import measured_statistics
from ahnn.dynamics.hamiltonians import make_hamiltonian
from ahnn.measurements import GroundStation, Instrument, Observations, Position
from ahnn.measurements.smoothing import smoothed
from ahnn.types import Trajectories

SD = 1e-3


def turning(rows=40):
    """Positions sqrt(t^2 + e^2), straight but for a sharp turn at t = 0, where the force is 1 / e."""
    times = torch.linspace(-3.0, 3.0, 121, dtype=torch.float64).expand(rows, -1)
    values = (times**2 + 0.05**2).sqrt().unsqueeze(-1)
    values = values + SD * torch.randn(values.shape, generator=generator(0), dtype=torch.float64)
    return values, times


def test_forces_are_told_where_a_polynomial_follows_the_motion():
    values, times = turning()
    instrument = Instrument(Position(1), torch.tensor([SD], dtype=torch.float64), 0.05, 1, 1.0)
    local = smoothed(instrument, values, times, 2_000)
    found = measured_statistics(local, instrument, Trajectories(values, times))
    exact = 0.05**2 / found.positions**3
    assert 0.75 < len(found.forces) / len(local.value) < 0.99
    assert float(found.positions.abs().min()) > 2 * 0.05
    assert float((found.forces - exact).abs().max()) < 0.2 / 0.05
    assert float(found.minimum[0]) < 2 * 0.05  # extremes are those of all samples


def test_distances_are_those_of_the_positions_in_space():
    """Two samples in ten of a circle of radius 2, counted from a point 5 away from its centre."""
    times = torch.linspace(0, 20, 401, dtype=torch.float64).expand(6, -1)
    phase = times + torch.arange(6.0).double().unsqueeze(1)
    centre = torch.tensor([3.0, 2.4, 3.2], dtype=torch.float64)
    axes = torch.tensor([[2.0, 0.0, 0.0], [0.0, 1.2, 1.6]], dtype=torch.float64)
    values = centre + torch.stack((phase.cos(), phase.sin()), dim=-1) @ axes
    instrument = Instrument(Position(3), torch.full((3,), SD, dtype=torch.float64), 0.05, 3, 3.0)
    local = smoothed(instrument, values, times, 5_000)
    found = measured_statistics(local, instrument, Trajectories(values, times))
    close(found.radius, torch.tensor([3.0, 7.0]), 1e-3)
    close(found.minimum, torch.tensor([1.0, 1.2, 1.6, -6.0, -3.6, -4.8]), 1e-2)
    close(found.maximum, torch.tensor([5.0, 3.6, 4.8, 6.0, 3.6, 4.8]), 1e-2)
    close(found.rate, torch.tensor([2.0, 1.2, 1.6, 6.0, 3.6, 4.8]) / 2**0.5, 3e-2)
    close(found.increment, 0.05 * found.rate, 1e-9)
    close(found.forces, 3 * (centre - found.positions), 2e-2)
    assert found.dt == pytest.approx(0.05, rel=1e-9)


def test_noise_of_sightings_is_no_perturbation_of_the_central_body():
    """The force before training, beside the exact one: angles of 0.02 degrees hide all but mu / r^2.

    In units of the noise of the sampled forces, the remainder was as large as the attraction.
    """
    mu, times = 398600.4418, 60.0 * torch.arange(241, dtype=torch.float64)
    angle = 2e-4 * times + torch.arange(6).unsqueeze(1)  # at 21,500 km
    flat = torch.stack((angle.cos(), 0.8 * angle.sin(), 0.6 * angle.sin()), dim=-1)
    places = (mu / 4e-8) ** (1 / 3) * flat
    sds = torch.tensor([0.05, 3.5e-4, 3.5e-4], dtype=torch.float64)
    station = GroundStation(67.86, 20.96)
    seen = station(places, times)
    values = seen + sds * torch.randn(seen.shape, generator=generator(4), dtype=torch.float64)
    measured = Observations(values, times.expand(6, -1))
    instrument = Instrument(station, sds, 240.0, 3, 1.0)
    found = measured_statistics(smoothed(instrument, *measured, 4_000), instrument, measured)
    for falloff in (0.0, 3.0):
        torch.manual_seed(0)
        options = {"mass": 1.0, "mu": None, "inputs": "isotropic", "scaling": "block", "network": TINY}
        body = make_hamiltonian("central_body", 3, falloff=falloff, **options).double()
        body.fit(found)
        exact = -mu * flat / places.norm(dim=-1, keepdim=True) ** 2
        close(body.force(places), exact, 0.02)
