"""What the trapezoidal rule is off by along paths, against closed forms."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import generator

from ahnn.shooting.path_sensitivities import Steps, in_quarters
from ahnn.shooting.quadrature import COARSE, coarse, rule_error

DOUBLE = {"dtype": torch.float64}


def harmonic(x):
    q, p = x.chunk(2, dim=-1)
    return torch.cat((p, -q), dim=-1)


def turning(times):
    """States (B, N + 1, 2) of a unit oscillator at times (B, N + 1)."""
    return torch.stack((times.sin(), times.cos()), dim=-1)


def test_it_is_a_twelfth_of_the_second_derivative():
    """Of a unit oscillator the second derivative of the force is the force."""
    times = 0.05 * torch.arange(400, **DOUBLE).unsqueeze(0)
    error = rule_error(harmonic, turning(times), times.diff(dim=1))
    assert error.tolist() == pytest.approx([0.05**2 / 12], rel=1e-2)


def test_uneven_steps_are_no_bends():
    steps = 0.02 * (0.5 + torch.rand(1, 1000, generator=generator(0), **DOUBLE))
    times = torch.cat((torch.zeros(1, 1, **DOUBLE), steps.cumsum(1)), dim=1)
    expected = float((steps[:, 1:] * steps[:, :-1]).mean()) / 12
    assert rule_error(harmonic, turning(times), steps).tolist() == pytest.approx([expected], rel=0.05)


def test_a_path_is_judged_alone_and_up_to_where_it_is_lost():
    times = torch.tensor([[0.4], [0.01], [0.01]], **DOUBLE) * torch.arange(50, **DOUBLE)
    states, steps = turning(times), times.diff(dim=1)
    errors = rule_error(harmonic, states, steps)
    assert float(errors[0]) > COARSE > float(errors[1:].max())
    assert coarse(harmonic, states, steps)
    assert not coarse(harmonic, states[1:], steps[1:])
    states[0, 30:] = torch.nan
    states[1, 49] = torch.inf
    lost = rule_error(harmonic, states, steps)
    assert float(lost[0]) == pytest.approx(float(errors[0]), rel=0.05)
    assert float(lost[1]) == pytest.approx(float(errors[1]), rel=0.05)
    assert float(lost[2]) == float(errors[2])


def test_a_step_alone_says_nothing():
    states = turning(torch.tensor([[0.0, 1e-6]], **DOUBLE))
    assert math.isinf(float(rule_error(harmonic, states, torch.full((1, 1), 1e-6, **DOUBLE))))
    assert not coarse(harmonic, states[:0], torch.zeros(0, 1, **DOUBLE))  # no path asks for anything


def test_quarters_begin_at_the_states_of_the_path():
    times = torch.tensor([[0.0, 0.1, 0.4], [1.0, 1.3, 1.4]], **DOUBLE)
    states, lengths = turning(times), times.diff(dim=1)

    def increment(x, dt):
        q, p = x.unbind(-1)
        return torch.stack((q * dt.cos() + p * dt.sin(), p * dt.cos() - q * dt.sin()), dim=-1) - x

    states[0, 1] += 5.0
    found = in_quarters(increment, states, lengths)
    steps = Steps(lengths, torch.arange(3)).quarters()
    assert found.shape == (2, 9, 2)
    assert bool((found[:, ::4] == states).all())
    within = turning(times[1, 0] + steps.lengths[1].cumsum(0))
    assert float((found[1, 1:] - within).abs().max()) < 1e-12
    assert float((found[0, 5:8].norm(dim=-1) - states[0, 1].norm()).abs().max()) < 1e-12
