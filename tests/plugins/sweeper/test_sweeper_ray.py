"""A sweep on a local Ray cluster, with the extra `ray`."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweeps import SEARCH, assert_none_lost_or_doubled, states, sweep, trials

pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="the extra ray is not installed")


@pytest.mark.slow
def test_two_workers_of_ray_lose_and_repeat_nothing_when_one_is_killed(tmp_path: Path):
    ray = "hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2", "hydra.sweeper.batch_size=2"
    code, output = sweep(tmp_path / "sweep", *SEARCH, *ray, "hydra.sweeper.n_trials=4", "killed=[1]")
    assert code == 0, output
    assert "A worker died or was killed" in output
    found = trials(tmp_path / "sweep")
    assert_none_lost_or_doubled(found, 4)
    assert states(found) == ["COMPLETE"] * 4
