"""Members at once are, to rounding, each member alone: increments, fields and gradients."""

from __future__ import annotations

import copy

import pytest
import torch
from helpers import SPRING, build_model, close, random_states

from ahnn.dynamics import StackedDynamics
from ahnn.statistics import Statistics
from ahnn.types import Trajectories

COUNT, ROWS = 3, 24
KINDS = {
    "generic in C": ("hnn", {}),
    "generic by operations": ("hnn", {"network": {"width": 6, "depth": 2, "activation": "sine"}}),
    "known kinetic energy": ("mechanical", {"integrator": {"name": "leapfrog"}}),
    "network of the field": ("node", {}),
    "implicit steps": ("hnn", {"integrator": {"name": "gl4"}}),
    "network of the state": ("mlp", {}),
}


def members(kind, dtype):
    name, changes = KINDS[kind]
    states = random_states(SPRING, 40, 5).unflatten(0, (8, 5))
    times = (SPRING.dt * torch.arange(5, dtype=torch.float64)).expand(8, 5)
    statistics, made = Statistics.of(Trajectories(states, times)), []
    for seed in range(COUNT):
        torch.manual_seed(seed)
        dynamics = build_model(name, SPRING, **changes).dynamics
        dynamics.fit(statistics)
        made.append(dynamics.to(dtype))
    return made


def gradients(dynamics):
    return [p.grad if p.grad is not None else torch.zeros_like(p) for p in dynamics.parameters()]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_increments_and_gradients_are_those_of_each_member_alone(kind, dtype):
    together = members(kind, dtype)
    alone = copy.deepcopy(together)
    x = random_states(SPRING, COUNT * ROWS, 1).to(dtype)
    weights = torch.linspace(-1, 2, x.numel(), dtype=dtype).view_as(x)
    single = kind == "network of the state"
    dt = SPRING.dt if single else torch.linspace(0.004, 0.02, len(x), dtype=dtype)
    found = StackedDynamics(together).increment(x, dt)
    (weights * found).sum().backward()
    for k, dynamics in enumerate(alone):
        own = slice(k * ROWS, (k + 1) * ROWS)
        wanted = dynamics.increment(x[own], dt[own] if isinstance(dt, torch.Tensor) else dt)
        (weights[own] * wanted).sum().backward()
        accuracy = 2e-5 if dtype == torch.float32 else 1e-11
        close(found[own], wanted, accuracy)
        for one, other in zip(gradients(together[k]), gradients(dynamics), strict=True):
            assert float((one - other).abs().max()) <= accuracy * max(float(other.abs().max()), 1e-3)


def test_fields_are_those_of_each_member_alone():
    made = members("generic in C", torch.float64)
    x = random_states(SPRING, COUNT * ROWS, 2)
    wanted = [dynamics.field(part) for dynamics, part in zip(made, x.chunk(COUNT), strict=True)]
    close(StackedDynamics(made).field(x), torch.cat(wanted), 1e-11)


def test_states_of_one_member_do_not_touch_the_gradient_of_another():
    made = members("generic in C", torch.float64)
    x = random_states(SPRING, COUNT * ROWS, 3)
    StackedDynamics(made).increment(x, SPRING.dt)[:ROWS].square().sum().backward()
    assert max(float(g.abs().max()) for g in gradients(made[0])) > 0
    assert all(float(g.abs().max()) == 0 for other in made[1:] for g in gradients(other))
