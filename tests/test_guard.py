"""What watches a training: finite weights in every checkpoint, curves of short runs, rollouts that choose."""

from __future__ import annotations

import math

import pytest
import torch
from entry import SMALL, call
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from ahnn.checkpoints import read_checkpoint

LAPTOP = [*SMALL, "data.batch_size=40", "model.network.width=4"]


def spoiled(steps):
    return ["+callbacks.spoil._target_=entry.SpoilAfter", f"+callbacks.spoil.steps={steps}"]


def weights(path):
    return torch.cat([w.flatten().double() for w in read_checkpoint(path)["state_dict"].values()])


@pytest.mark.parametrize(
    ("steps", "epochs", "every", "kept"),
    [(10, 1, 500, None), (20, 3, 500, 10), (15, 3, 5, 10), (25, 3, 5, 20)],
)
def test_no_checkpoint_ever_holds_weights_that_are_not_finite(tmp_path, capsys, steps, epochs, every, kept):
    changes = [f"trainer.max_epochs={epochs}", f"callbacks.last.every={every}", *spoiled(steps)]
    assert call("ahnn.train", "recipe=first_order", "budget=smoke", *SMALL, *changes, f"run={tmp_path}") == 3
    assert "last good checkpoint is kept" in capsys.readouterr().err
    written = list((tmp_path / "checkpoints").glob("*.ckpt"))
    assert all(weights(path).isfinite().all() for path in written)
    if kept is None:
        assert not written
    else:
        assert read_checkpoint(tmp_path / "checkpoints" / "last.ckpt")["global_step"] == kept


def latest_rollout(path):
    (state,) = (v for k, v in read_checkpoint(path)["callbacks"].items() if "ValidationRollout" in k)
    return state["latest"]


def curve(folder, name):
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return [point.value for point in events.Scalars(name)]


@pytest.mark.parametrize("optimiser", [["recipe=first_order", "budget=smoke"], []])
def test_a_short_training_has_curves_with_a_gradient_that_is_not_zero(tmp_path, optimiser):
    small = [*(SMALL if optimiser else LAPTOP)]
    small.remove("logger=none")
    assert call("ahnn.train", *optimiser, *small, "trainer.max_epochs=2", f"run={tmp_path}") == 0
    for name in ("train/loss", "train/gradient_norm"):
        values = curve(tmp_path, name)
        assert len(values) >= 8
        assert all(value > 0 for value in values)
    rollouts = curve(tmp_path, "val/rollout")
    assert len(rollouts) == 2
    assert rollouts[-1] == pytest.approx(latest_rollout(tmp_path / "checkpoints" / "last.ckpt"), rel=1e-6)


def test_rollouts_of_some_epochs_choose_among_these_and_the_last(tmp_path):
    changes = ["callbacks.rollout.every=2", "trainer.max_epochs=3"]
    assert call("ahnn.train", *LAPTOP, *changes, f"run={tmp_path}") == 0
    path = tmp_path / "checkpoints" / "best.ckpt"
    assert read_checkpoint(path)["epoch"] in (1, 2)
    assert 0 < latest_rollout(path) < math.inf
