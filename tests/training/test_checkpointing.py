"""The best point is that of the smallest value; the resume point comes when it is due."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from ahnn.errors import TrainingError, UserError
from ahnn.training.callbacks import checkpointing
from ahnn.training.callbacks.checkpointing import BestPoint, ResumePoint


class Trainer(SimpleNamespace):
    """What the points ask of a trainer; it notes what was written."""

    def __init__(self, **changes):
        state = SimpleNamespace(fn="fit")
        super().__init__(state=state, sanity_checking=False, callbacks=[], callback_metrics={}, written=[])
        self.__dict__.update({"global_step": 1, "is_last_batch": False} | changes)

    def save_checkpoint(self, path):
        self.written.append((path.name, self.global_step, dict(self.callback_metrics)))


def values_written(series, best):
    trainer = Trainer()
    for value in series:
        trainer.callback_metrics = {"val/loss": torch.tensor(value, dtype=torch.float64)}
        best.on_validation_end(trainer, None)
    return [float(metrics["val/loss"]) for _, _, metrics in trainer.written]


def test_the_best_point_is_the_smallest_value_so_far(tmp_path):
    best = BestPoint(str(tmp_path), "val/loss")
    assert values_written([3.0, 2.0, 2.5, 2.0, math.nan, 1.0, math.inf, 5.0, -1.0], best) == [3, 2, 1, -1]
    assert best.state_dict() == {"best": -1.0}
    again = BestPoint(str(tmp_path), "val/loss")
    again.load_state_dict({"best": 2.0})
    assert values_written([2.5, 2.0, 1.9], again) == [1.9]


@pytest.mark.parametrize("series", [[math.nan, math.inf], [math.inf]])
def test_a_training_in_which_no_validation_was_finite_has_diverged(tmp_path, series):
    best = BestPoint(str(tmp_path), "val/loss")
    best.on_train_end(Trainer(), None)  # no validation is no failure
    assert values_written(series, best) == []
    with pytest.raises(TrainingError, match=r"the loss became inf in every validation \(val/loss\)"):
        best.on_train_end(Trainer(), None)
    assert values_written([3.0, math.nan], best) == [3]
    best.on_train_end(Trainer(), None)


@pytest.mark.parametrize(
    ("change", "written"),
    [({"sanity_checking": True}, ["best.ckpt"]), ({"state": SimpleNamespace(fn="validate")}, [])],
    ids=["before the first step", "outside of a training"],
)
def test_weights_before_the_first_step_may_be_the_best_and_no_others_outside(tmp_path, change, written):
    trainer = Trainer(callback_metrics={"val/loss": torch.tensor(1.0)}, **change)
    BestPoint(str(tmp_path), "val/loss").on_validation_end(trainer, None)
    ResumePoint(str(tmp_path), 5).on_validation_end(trainer, None)
    assert [name for name, *_ in trainer.written] == written


def test_a_value_that_nothing_logs_is_refused(tmp_path):
    best = BestPoint(str(tmp_path), "rollout/typical")
    with pytest.raises(UserError, match="expected one of val/loss, val/one_step; received 'rollout/typical'"):
        best.check(Trainer())
    best.check(Trainer(callbacks=[SimpleNamespace(monitored=("rollout/typical",))]))
    for name in checkpointing.MONITORED:
        BestPoint(str(tmp_path), name).check(Trainer())


def test_the_resume_point_is_written_every_few_steps_but_not_on_the_last_batch(tmp_path):
    point, module = ResumePoint(str(tmp_path), 3), torch.nn.Linear(1, 1)
    trainer = Trainer()
    for trainer.global_step in range(1, 13):
        trainer.is_last_batch = trainer.global_step in (6, 11)
        point.on_train_batch_end(trainer, module, None, None, 0)
        if trainer.is_last_batch:
            point.on_validation_end(trainer, module)
    assert [(name, step) for name, step, _ in trainer.written] == [
        ("last.ckpt", step) for step in (3, 6, 9, 11, 12)
    ]
    with torch.no_grad():
        module.weight.fill_(torch.inf)
    trainer.global_step, trainer.is_last_batch = 15, False
    with pytest.raises(TrainingError, match="at step 15"):
        point.on_train_batch_end(trainer, module, None, None, 0)
    assert len(trainer.written) == 5
