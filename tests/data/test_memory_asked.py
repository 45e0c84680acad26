"""The memory that is asked for before it is taken is about that of what is then there."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import MOLNIYA, SPRING, data_module

from ahnn.data import Simulated, datamodule, generate, sensor, sources
from ahnn.types import Trajectories


@pytest.fixture
def asked(monkeypatch):
    """What is asked for, by its name."""
    sizes = {}
    for module in (datamodule, generate, sensor):
        monkeypatch.setattr(module, "require_memory", lambda name, _, size: sizes.update({name: size}))
    return sizes


@pytest.mark.parametrize(("window", "batch"), [(1, 8), (3, 32), (3, 10**6)])
def test_a_batch_of_windows(asked, cache, window, batch):
    data = data_module(SPRING, cache, window=window, batch_size=batch)
    first = next(iter(data.train_dataloader()))
    size = first.start.nbytes + first.increments.nbytes
    assert size <= asked["data.batch_size"] <= 2.5 * size  # gathered, and handed out


def test_the_speeds_of_all_windows(asked, cache):
    loader = data_module(SPRING, cache, window=2, emphasis=1.0).train_dataloader()
    assert 2 <= asked["data.emphasis"] / loader.windows.speeds().nbytes <= 4  # with their powers and sums
    asked.clear()
    data_module(SPRING, cache, window=2).train_dataloader()
    assert "data.emphasis" not in asked


def test_the_states_of_a_trajectory(asked):
    made = generate.generate(dataclasses.replace(SPRING, steps=20), 3, 0)
    assert asked["system.steps, system.periods"] == pytest.approx(made.states[0].nbytes, rel=1e-12)


def test_measurements_while_they_are_drawn(asked):
    truth = Trajectories(torch.zeros(5, 40, 6).double(), torch.arange(40.0).double().expand(5, -1))
    for measured, every in (("state", 1), ("position", 4)):
        seen = sensor.Sensor(MOLNIYA.space, measured=measured, noise=0.1, every=every).measure(truth, 0)
        assert 3 <= asked["data.trajectories, system.steps"] / seen.values.nbytes <= 5


def test_trajectories_on_the_disk(tmp_path, monkeypatch):
    sizes = []
    monkeypatch.setattr(
        sources, "require_disk", lambda name, _, size, place: sizes.append((name, size, place))
    )
    source = Simulated(dataclasses.replace(SPRING, steps=20), trajectories=7, seed=0, cache=str(tmp_path))
    source.check()
    made = source.read()
    assert sizes == [("data.trajectories, system.steps", made.states.nbytes, tmp_path)]
    source.check()  # it is there
    assert len(sizes) == 1
