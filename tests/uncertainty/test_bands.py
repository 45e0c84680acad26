"""Bands of rollouts: central differences, Monte Carlo, and what a network knows outside its data."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.data.segments import Segments
from ahnn.data.sensor import Sensor
from ahnn.dynamics import make_dynamics
from ahnn.rollouts import rollout
from ahnn.shooting.path_sensitivities import path
from ahnn.statistics import Statistics
from ahnn.systems import Pendulum
from ahnn.systems.truth import exact_flow
from ahnn.training import LevenbergMarquardt, pointwise_problem
from ahnn.training.laplace import conclude
from ahnn.types import Trajectories
from ahnn.uncertainty import rollout_covariances

FACTOR = torch.tensor([[2e-3, 0.0], [-1e-3, 3e-3]], **DOUBLE)


def starts(count=5):
    return torch.randn(count, 2, generator=generator(4), **DOUBLE)


def lengths(count=5, steps=150):
    return 0.02 * (0.5 + torch.rand(count, steps, generator=generator(5), **DOUBLE))


@torch.no_grad()
@pytest.mark.parametrize(("longer", "count", "off"), [(1, 150, 1e-3), (5, 60, 7e-4)])
def test_covariances_are_those_of_central_differences(longer, count, off):
    """Steps that are long for the trapezoidal rule, but not for the flow, are followed in quarters."""
    dynamics, x, dt = Swing(), starts(), longer * lengths(steps=count)
    theta, e, slopes = parameters_to_vector(dynamics.parameters()), 1e-5, []
    for unit in torch.eye(2, **DOUBLE):
        ends = []
        for side in (e, -e):
            vector_to_parameters(theta + side * unit, dynamics.parameters())
            ends.append(path(dynamics.increment, x, dt))
        slopes.append((ends[0] - ends[1]) / (2 * e))
    design = torch.stack(slopes, dim=-1) @ FACTOR
    vector_to_parameters(theta, dynamics.parameters())
    found = rollout_covariances(dynamics, x, dt, FACTOR)
    close(found, design @ design.mT, off)
    assert float(found[:, 0].abs().max()) == 0  # the start is known


@torch.no_grad()
def test_a_band_does_not_depend_on_its_neighbours():
    """A long step beside fifty rollouts in short ones is looked into as it would be alone."""
    x, long = starts(51), 5 * lengths(1, 60)
    dt = torch.cat((long, 0.05 * long.expand(50, -1)))
    together = rollout_covariances(Swing(), x, dt, FACTOR)
    close(together[:1], rollout_covariances(Swing(), x[:1], long, FACTOR), 1e-5)


@torch.no_grad()
def test_a_batch_in_parts_is_the_batch(monkeypatch):
    whole = rollout_covariances(Swing(), starts(), lengths(), FACTOR)
    monkeypatch.setattr("ahnn.uncertainty.bands.CELLS", 1500)  # two rows
    close(rollout_covariances(Swing(), starts(), lengths(), FACTOR), whole, 1e-6)


@pytest.fixture(scope="module")
def small_swings():
    """A potential learned from swings of at most 1 rad, angles measured to 0.01 rad."""
    torch.manual_seed(0)
    system = Pendulum(name="pendulum", dt=0.05, steps=60, q0=(-1.0, 1.0))
    x = system.initial_states(60, generator(0))
    states = rollout(exact_flow(system), x, system.dt, system.steps + 1)
    data = Trajectories(states, system.dt * torch.arange(61, **DOUBLE).expand(60, -1))
    options = {"inertia": 1.0, "hamiltonian": "mechanical", "mu": None, "inputs": "cartesian", "dof": 1}
    network = {"width": 8, "depth": 1, "activation": "tanh"}
    dynamics = make_dynamics(
        "hamiltonian", **options, scaling="block", network=network, integrator={"name": "rk4"}
    ).double()
    dynamics.fit(Statistics.of(data))
    samples = states[:, ::4].flatten(0, 1)
    rates = torch.stack((samples[:, 1], system.force(samples[:, :1]).squeeze(-1)), dim=-1)
    weights = torch.ones_like(samples)
    optimizer = LevenbergMarquardt(dynamics.parameters())
    for _ in range(40):
        problem = pointwise_problem(dynamics, dynamics.field, samples, rates, weights)
        optimizer.step(lambda problem=problem: (problem, None))
    sensor = Sensor(system.space, measured="position", noise=0.01)
    segments = Segments(sensor.measure(data, 0), None, sensor.instrument(system.dt))
    train, held_out = segments.gather(torch.arange(50)), segments.gather(torch.arange(50, 60))
    return system, dynamics, conclude(dynamics, train, held_out, 3)


def test_the_band_holds_errors_inside_the_data_and_is_wide_outside(small_swings):
    system, dynamics, found = small_swings
    x = torch.tensor([[0.3, 0.0], [0.6, 0.0], [0.9, 0.0], [1.5, 0.0], [2.5, 0.0]], **DOUBLE)
    truth = rollout(exact_flow(system), x, system.dt, 61)
    error = (rollout(dynamics, x, system.dt, 61) - truth).abs()
    dt = torch.full((5, 60), system.dt, **DOUBLE)
    sd = rollout_covariances(dynamics, x, dt, found.spread).diagonal(dim1=-2, dim2=-1).sqrt()
    size = sd.square().mean((1, 2)).sqrt()
    assert float(size[:3].max()) < 0.02
    assert float(size[3]) > 5 * float(size[:3].max())
    assert float(size[4]) > 20 * float(size[:3].max())
    assert float((error <= 3 * sd)[:3].double().mean()) > 0.97
    assert 2 < found.about["determined"] < 15 < found.about["parameters"]


def test_a_tight_noise_makes_a_tight_band(small_swings):
    _, dynamics, found = small_swings
    x, dt = torch.tensor([[0.6, 0.0]], **DOUBLE), torch.full((1, 60), 0.05, **DOUBLE)
    double = dataclasses.replace(found, inflation=4 * found.inflation)
    plain, wide = (rollout_covariances(dynamics, x, dt, u.spread) for u in (found, double))
    close(wide, 4 * plain, 1e-5)
    close(found.covariance, found.spread @ found.spread.mT, 1e-12)
