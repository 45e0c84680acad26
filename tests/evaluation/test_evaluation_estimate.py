"""The announced time of an evaluation: its rollouts, those of a plugin, and flows that depend on time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from ahnn.jobs import evaluation_estimate
from ahnn.jobs.evaluation_estimate import TESTS, evaluation_seconds
from ahnn.training.closing_estimate import ShootingCost


class Timed:
    """A flow of one degree of freedom and the clock, a step of which takes 0.01 s on a clock of its own."""

    clock = 1

    def __init__(self):
        self.now, self.shapes = 0.0, []

    def frozen(self):
        return self

    def cpu(self):
        return self

    def __call__(self, z, dt):
        self.now += 0.01
        self.shapes.append((tuple(z.shape), dt))
        return z


class Costly:
    """A plugin that takes as long as three rollouts, and one more for each hundred samples."""

    def rollouts(self, samples):
        return 3 + samples / 100


@pytest.mark.parametrize(("plugins", "rollouts"), [({}, 1), ({"costly": Costly()}, 6)])
def test_rollouts_of_a_flow_of_time_and_of_a_plugin_count(plugins, rollouts, monkeypatch):
    flow = Timed()
    data = SimpleNamespace(
        splits={"test": SimpleNamespace(states=torch.zeros(4, 200, 2))},
        source=SimpleNamespace(truth=None),
        examples=lambda: torch.rand(3, 2),
        statistics=lambda: SimpleNamespace(dt=0.5),
        measured=lambda _: SimpleNamespace(times=torch.zeros(4, 50)),
    )
    given = {"data": data, "model": SimpleNamespace(dynamics=flow), "report": {"figures": False}}
    prepared: Any = SimpleNamespace(**given, plugins=plugins)
    monkeypatch.setattr(evaluation_estimate.time, "perf_counter", lambda: flow.now)
    assert evaluation_seconds(prepared) == pytest.approx(200 * 0.01 * rollouts)
    assert set(flow.shapes) == {((8, 4), 0.5)}
    cost = ShootingCost(1e-3, 0.0, quartered=False)  # an iteration of 4 segments of 50 samples takes 5.2 s
    assert evaluation_seconds(prepared, cost) == pytest.approx(200 * 0.01 * rollouts + TESTS * 5.2)
