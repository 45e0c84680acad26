"""Tasks of maps from sample to sample: drawings, scores, and the budgets of the models of the field."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close

from ahnn.rollouts import rollout
from ahnn.systems.truth import exact_flow
from ahnn.tasks import TASKS, flow_maps
from ahnn.tasks.definition import flow_through_encounters
from ahnn.tasks.flow_maps import DOUBLE, PENDULUM, Sampling, first_quarter, hanging


def small(system, tested, **options):
    links = system.dof
    begin = lambda count, draw: hanging(count, draw, links=links, most=0.5)  # noqa: E731
    return flow_maps.draw(0, sampling=Sampling(system, 20, tested, begin, **options))


def test_a_quarter_swing_ends_behind_its_first_zero():
    time = torch.linspace(0, 6, 25, dtype=torch.float64)
    swing = torch.stack(
        (torch.stack((time.cos(), -time.sin()), -1), -torch.stack((time.cos(), -time.sin()), -1))
    )
    cut = first_quarter(swing)
    there = (~cut.isnan()).all(-1)
    assert there.sum(1).tolist() == [8, 8]  # 1.75 is the first multiple of 0.25 past pi / 2
    assert torch.equal(cut[there], swing[:, :8].reshape(-1, 2))


def test_trainings_see_a_quarter_swing_and_tests_are_whole_swings():
    draw = small(PENDULUM, 30, quarter=True)
    states = draw.data.states
    there = ~states[..., 0].isnan()
    for run, some in zip(states, there, strict=True):
        seen = run[some]
        assert float(seen[-2, 0] * seen[0, 0]) > 0 > float(seen[-1, 0] * seen[0, 0])
    energy = PENDULUM.energy(states)
    assert float((energy - energy[:, :1]).nan_to_num(nan=0.0).abs().max()) < 1e-9


@pytest.mark.parametrize("system", [PENDULUM, DOUBLE], ids=["pendulum", "double pendulum"])
def test_an_error_counts_angles_to_a_full_turn(system):
    draw, flow = small(system, 12), exact_flow(system)

    def turned(by):
        def predict(x, steps, dt):
            path = rollout(flow, x, dt, steps + 1).clone()
            path[..., 0] += by
            return path

        return predict

    assert draw.score(turned(0.0)) < 1e-12
    assert draw.score(turned(2 * math.pi)) < 1e-12
    size = 2 * system.dof
    assert draw.score(turned(0.5)) == pytest.approx(0.5 / size, rel=1e-9)
    assert draw.score(turned(-5.0)) == pytest.approx((2 * math.pi - 5.0) / size, rel=1e-9)


def test_the_truth_of_bodies_that_meet_closely_conserves_their_energy():
    """One run in a hundred or so gains 100 times its energy in the substeps of a run without encounters."""
    start = flow_maps.bodies(400, 0)
    states = rollout(flow_through_encounters(flow_maps.THREE), start, flow_maps.THREE.dt, 11)
    energy = flow_maps.THREE.energy(states)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-3 * float(energy.abs().max())


def test_hanging_pendulums_are_at_rest_at_most_so_far_out():
    x = hanging(4000, 3, links=2, most=0.5)
    assert float(x[:, 2:].abs().max()) == 0
    close(x[:, :2].abs().max(), torch.tensor(math.pi / 2, dtype=torch.float64), 1e-2)
    assert not torch.equal(x, hanging(4000, 4, links=2, most=0.5))


@pytest.mark.parametrize("name", list(flow_maps.TASKS))
def test_all_models_of_a_task_have_one_budget(name):
    models = TASKS[name].models
    assert {"sympnet_G", "sympnet_LA", "henon_net", "ghnn", "srnn", "hnn", "node", "mlp"} <= models.keys()
    assert len({next(o for o in options if "max_epochs" in o) for options in models.values()}) == 1
    assert len({next(o for o in options if "windows" in o) for options in models.values()}) == 1
