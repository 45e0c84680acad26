"""Jacobians in closed form are those of vectorised reverse mode, and whole steps by either are the same."""

from __future__ import annotations

import pytest
import torch
from helpers import MOLNIYA, batch_of, close, data_module, generator, ready_model
from test_written_out import METHODS, OWN_STEPS, dynamics
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.derivatives import (
    field_jacobian,
    increment_jacobian,
    mapped_field_jacobian,
    mapped_increment_jacobian,
)
from ahnn.training import LevenbergMarquardt

WIDE = torch.float64


def states() -> torch.Tensor:
    return torch.randn(5, 4, generator=generator(1), dtype=WIDE)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_the_field_and_its_rows(activation, depth):
    own = dynamics(activation, depth=depth)
    theta, x = parameters_to_vector(own.parameters()).detach(), states()
    factors = torch.rand(5, 4, generator=generator(2), dtype=WIDE)
    found = field_jacobian(own, WIDE)(theta, x, factors)
    close(found, mapped_field_jacobian(own, WIDE)(theta, x, factors), 1e-12)
    stacked = field_jacobian(own, WIDE)(theta, x.expand(2, 5, 4))
    for one in stacked:
        close(one * factors.unsqueeze(-1), found, 1e-13)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize(("method", "dt"), [*((m, 0.2) for m in METHODS), ("rk4", OWN_STEPS)])
def test_steps_and_their_rows(activation, method, dt):
    own = dynamics(activation, method)
    theta, x = parameters_to_vector(own.parameters()).detach(), states()
    found = increment_jacobian(own, WIDE)(theta, x, dt)
    expected = mapped_increment_jacobian(own, own.increment, WIDE)(theta, x, dt)
    for one, other in zip(found, expected, strict=True):
        close(one, other, 1e-12)


@pytest.mark.parametrize("name", ["generic", "hnn_derivative"])
def test_a_step_of_levenberg_marquardt_is_the_same_by_both_ways(cache, monkeypatch, name):
    ways = []
    for known in (True, False):
        data = data_module(MOLNIYA, cache, window=3)
        model = ready_model(name, data)
        if not known:
            monkeypatch.setattr("ahnn.dynamics.derivatives.has_rows", lambda _: False)
        optimizer = LevenbergMarquardt(model.dynamics.parameters(), damping=100.0)
        before = parameters_to_vector(model.dynamics.parameters()).detach().clone()
        problem = model.objective.problem(model.dynamics, batch_of(data, 30))
        loss = optimizer.step(lambda problem=problem: (problem, None))
        moved = parameters_to_vector(model.dynamics.parameters()).detach() - before
        assert float(moved.norm()) > 0
        ways.append((loss, optimizer.param_groups[0]["damping"], moved))
    assert ways[0][:2] == ways[1][:2]
    close(ways[0][2], ways[1][2], 1e-3)  # J has the eps of float32, and the damping is large
