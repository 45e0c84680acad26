"""The commands of the demonstrations, small: they train, judge, and are judged again without --trust."""

from __future__ import annotations

import pytest
from entry import call

from ahnn.evaluation import Who, load_results

SMALL = ["trainer.max_epochs=1", "model.network.width=4", "data.windows_per_epoch=200", "logger=none"]
SMALL += ["trainer.accelerator=cpu", "callbacks.rollout.count=2"]
PLANETS = ["experiment=planets", "system.samples=40", "data.batch_size=20", "loss.stages=[[6,1.0]]"]
KNOWN = ["experiment=planets_known", "system.samples=60", "plugins.horizon.arc=40", "window=59"]
MOLNIYA = ["experiment=real_molniya", "system.samples=300", "plugins.horizon.arc=200", "data.batch_size=200"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "command", "judge", "others"),
    [
        ("jplephem", PLANETS, "attraction", [Who("Kepler", "true")]),
        ("jplephem", KNOWN, "horizon", [Who("known part", "true"), Who("two-body", "true")]),
        ("sgp4", MOLNIYA, "horizon", [Who("J2", "true"), Who("J2", "true", "ukf"), Who("two-body", "true")]),
    ],
)
def test_a_demonstration_runs_and_is_judged_again(tmp_path, module, command, judge, others):
    pytest.importorskip(module, reason="an extra is needed")
    run = f"run={tmp_path / 'run'}"
    assert call("ahnn.train", *command, *SMALL, run) == 0
    assert call("ahnn.evaluate", run, "name=again") == 0
    first, again = (load_results(tmp_path / "run" / part) for part in ("", "evaluations/again"))
    assert judge in first.numbers
    assert all(first.row(who) is not None for who in others)
    assert [row.scores.position for row in first.rows] == [row.scores.position for row in again.rows]
