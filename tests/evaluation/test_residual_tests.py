"""Defects of noise that residuals tell apart, and errors of the dynamics."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import SPRING, trajectories
from helpers import generator
from test_goodness_of_fit import Spring

from ahnn.data.segments import Segments
from ahnn.data.sensor import Sensor
from ahnn.dynamics import make_dynamics
from ahnn.evaluation.residual_diagnosis import invisible, remedy, verdicts
from ahnn.evaluation.residual_tests import residual_tests
from ahnn.measurements import GroundStation

SD, COUNT = 0.01, 16
SPRINGS = {"kind": "spring", "stiffness": 5.0}
SYSTEM = dataclasses.replace(SPRING, steps=400)


def batch(noise):
    """Positions of a spring with noise in standard deviations, (B, K, 1)."""
    truth = trajectories(SYSTEM, COUNT, 5)
    sensor = Sensor(SYSTEM.space, measured="position", noise=SD, every=4)
    found = Segments(sensor.measure(truth, 0), None, sensor.instrument(SYSTEM.dt)).gather(torch.arange(COUNT))
    return found._replace(values=truth.states[:, ::4, :1] + SD * noise)


def white(seed=0):
    return torch.randn(COUNT, 101, 1, generator=generator(seed), dtype=torch.float64)


def coloured(memory):
    noise = white()
    for k in range(1, noise.shape[1]):
        noise[:, k] = memory * noise[:, k - 1] + (1 - memory**2) ** 0.5 * noise[:, k]
    return noise


@pytest.mark.parametrize("seed", range(4))
def test_of_white_noise_nothing_is_said(seed):
    assert remedy(Spring(SYSTEM), batch(white(seed)), "none") == ""


def test_a_bias_of_half_a_standard_deviation_is_said_with_its_sign():
    said = remedy(Spring(SYSTEM), batch(white() + 0.5), "none")
    assert said.startswith("readings are biased: q +0.")
    assert float(said.split("q ")[1].split()[0]) == pytest.approx(0.5, abs=0.1)


def test_a_bias_of_each_trajectory_is_not_one_of_all():
    own = torch.randn(COUNT, 1, 1, generator=generator(1), dtype=torch.float64)
    own = own - own.mean()
    said = remedy(Spring(SYSTEM), batch(white() + own), "none")
    assert said.startswith("each trajectory has its own bias: q ")
    assert float(said.split("q ")[1].split()[0]) == pytest.approx(float(own.std()), rel=0.2)


@pytest.mark.parametrize("memory", [0.4, 0.8])
def test_colour_is_said_with_what_it_does_to_bands(memory):
    said = remedy(Spring(SYSTEM), batch(coloured(memory)), "none")
    assert said.startswith("the noise is coloured: successive values correlate by q +")
    assert float(said.split("q +")[1].split()[0]) == pytest.approx(memory, abs=0.12)
    widening = ((1 + memory) / (1 - memory)) ** 0.5
    assert float(said.split("are up to ")[1].split()[0]) == pytest.approx(widening, rel=0.25)


def test_errors_of_the_dynamics_are_no_colour():
    softer = dataclasses.replace(SYSTEM, stiffness=1.02 * SYSTEM.stiffness)
    said = remedy(Spring(softer), batch(white()), "none")
    assert said.endswith("depends on the state: the model misses part of the motion")


def test_a_bias_that_cannot_show_is_said():
    options = {"dof": 2, "inertia": 1.0, "hamiltonian": "mechanical", "mu": None, "scaling": "none"}
    options |= {"network": {"width": 4, "depth": 1, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    free = make_dynamics("hamiltonian", **options, inputs="cartesian")
    held = make_dynamics("hamiltonian", **options, inputs="cartesian", forces={"springs": SPRINGS})
    seen = batch(white())
    assert "would go unnoticed" in invisible(free, seen)
    assert invisible(held, seen) == ""
    assert invisible(make_dynamics("hamiltonian", **options, inputs="radial"), seen) == ""
    elsewhere = seen._replace(instrument=seen.instrument._replace(measurement=GroundStation(40.0, 10.0)))
    assert invisible(free, elsewhere) == ""


def test_numbers_that_were_not_measured_change_nothing():
    noise, times = coloured(0.8), torch.linspace(0, 4, 101).double().expand(COUNT, -1)
    states = torch.cat((times.unsqueeze(-1).sin(), times.unsqueeze(-1).cos()), -1)
    more = torch.cat((noise, torch.full_like(noise[..., :1], torch.nan)), -1)
    one, two = residual_tests(noise, states, times, 2), residual_tests(more, states, times, 4)
    assert torch.allclose(one.bias[0], two.bias[0], rtol=1e-12, atol=0)
    assert torch.allclose(one.correlation[0], two.correlation[0], rtol=1e-12, atol=0)
    said = verdicts(two, ("a", "b"), 0.04, "none")
    assert len(said) == 1
    assert " b " not in said[0]
