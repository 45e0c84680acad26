"""A checkpoint to go on from fits as a whole, or is refused before anything of it is loaded."""

from __future__ import annotations

import shutil

import pytest
import torch
from entry import FIRST, call

import ahnn
from ahnn.errors import UserError
from ahnn.evaluation import load_results


def spoiled(finished, path, change):
    """A checkpoint of the finished run with something else in it."""
    found = torch.load(finished / "checkpoints" / "last.ckpt", weights_only=True)
    change(found)
    torch.save(found, path)
    return path


SPOILED = {
    "a moment of another shape": (
        lambda c: c["optimizer_states"][0]["state"][0].update(exp_avg=torch.zeros(3)),
        "received different shapes of optimizer_states.0.state.0.exp_avg",
    ),
    "a step that is no number": (
        lambda c: c["optimizer_states"][0]["state"][0].update(step=torch.zeros(10_000)),
        "received different shapes of optimizer_states.0.state.0.step",
    ),
    "a step of another type": (
        lambda c: c["optimizer_states"][0]["state"][0].update(step=torch.zeros((), dtype=torch.int64)),
        "received different shapes of optimizer_states.0.state.0.step",
    ),
    "a tensor that is no moment": (
        lambda c: c["optimizer_states"][0]["state"][0].update(max_exp_avg_sq=torch.zeros(3)),
        "received different shapes of optimizer_states.0.state.0.max_exp_avg_sq",
    ),
    "a tensor in place of a number": (
        lambda c: c["optimizer_states"][0]["param_groups"][0].update(lr=torch.ones(3)),
        "received different shapes of optimizer_states.0.param_groups.0.lr",
    ),
    "the state of a parameter that is not there": (
        lambda c: c["optimizer_states"][0]["state"].update({99: {"exp_avg": torch.zeros(3)}}),
        "received different shapes of optimizer_states.0.state.99.exp_avg",
    ),
    "a missing moment": (
        lambda c: c["optimizer_states"][0]["state"][0].pop("exp_avg"),
        "received different shapes of optimizer_states.0.state.0.exp_avg",
    ),
    "a missing option": (
        lambda c: c["optimizer_states"][0]["param_groups"][0].pop("betas"),
        "expected a complete checkpoint; received KeyError('betas')",
    ),
    "a parameter too many": (
        lambda c: c["optimizer_states"][0]["param_groups"][0]["params"].append(99),
        "expected a complete checkpoint; received ValueError",
    ),
    "no progress": (
        lambda c: c["loops"]["fit_loop"].update(epoch_progress={}),
        "expected a complete checkpoint; received KeyError('total')",
    ),
    "no best value": (
        lambda c: c["callbacks"].update(BestPoint={"x": 1}),
        "expected a complete checkpoint; received KeyError('best')",
    ),
    "a moment that is no tensor": (
        lambda c: c["optimizer_states"][0]["state"][0].update(exp_avg=None),
        "received different shapes of optimizer_states.0.state.0.exp_avg",
    ),
    "a weight of another shape": (
        lambda c: c["state_dict"].update({"loss.unit": torch.ones(7)}),
        "received different shapes of loss.unit",
    ),
    "a weight too many": (lambda c: c["state_dict"].update({"x": torch.ones(1)}), "different shapes of x"),
    "steps that are no number": (
        lambda c: c.update(global_step=torch.tensor(torch.nan)),
        "received one without global_step",
    ),
    "a version that is none": (
        lambda c: c.update({"pytorch-lightning_version": "x"}),
        "expected a complete checkpoint; received ",
    ),
    "a tensor among what is known": (
        lambda c: c["ahnn"]["data"]["recipe"].update(seed=torch.zeros(3)),
        "expected a checkpoint written by ahnn",
    ),
    "no loops": (lambda c: c.pop("loops"), "received one without loops"),
    "no optimiser": (lambda c: c.pop("optimizer_states"), "received one without optimizer_states"),
}


@pytest.mark.parametrize("what", SPOILED)
def test_a_checkpoint_that_does_not_fit_is_refused_before_it_is_loaded(finished, tmp_path, capfd, what):
    change, expected = SPOILED[what]
    path = spoiled(finished, tmp_path / "odd.ckpt", change)
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}", f"ckpt={path}") == 2
    assert expected in capfd.readouterr().err


def test_more_epochs_than_planned_are_a_new_run_from_the_weights(finished, tmp_path, capfd):
    shutil.copytree(finished, tmp_path / "run")
    more = [*FIRST, "trainer.max_epochs=4"]
    assert call("ahnn.train", *more, f"run={tmp_path / 'run'}", "ckpt=last") == 2
    heading, *differences, remedy = capfd.readouterr().err.splitlines()[-5:]
    assert heading.endswith("belongs to a different training run:")
    keys = ("scheduler.max_epochs", "scheduler.upper_bound", "trainer.max_epochs")
    assert differences == [f"  settings.{key}: expected 3, received 4" for key in keys]
    said = f"weights={tmp_path / 'run'}"
    assert remedy == f"To train the same model further, start a new run: {said} run=NEW"
    assert call("ahnn.train", *more, said, f"run={tmp_path / 'new'}") == 0
    assert load_results(tmp_path / "new").training["steps"] == 40


def test_a_finished_run_has_no_steps_left(finished, tmp_path, capfd):
    shutil.copytree(finished, tmp_path / "run")
    capfd.readouterr()
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}", "ckpt=last") == 0
    assert ": 0 optimiser steps of 16 windows in 0 epochs, about 0 s" in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("optimizer", ["soap", "levenberg_marquardt"])
def test_a_run_with_another_optimiser_goes_on_and_is_no_run_with_this_one(
    finished, tmp_path, capfd, optimizer
):
    run = [*FIRST, f"optimizer={optimizer}", "scheduler=none", "data.precision=64", f"run={tmp_path / 'run'}"]
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.steps=25", "+callbacks.cut.ctrl_c=true"]
    assert call("ahnn.train", *run, *cut) == 130
    assert call("ahnn.train", *run, "ckpt=last") == 0
    assert load_results(tmp_path / "run").training["steps"] == 30
    other = [*run[:-1], f"run={tmp_path / 'other'}", f"ckpt={finished / 'checkpoints' / 'last.ckpt'}"]
    assert call("ahnn.train", *other) == 2
    assert "belongs to a different training run" in capfd.readouterr().err


def test_weights_that_are_not_finite_are_not_judged(finished, tmp_path):
    path = spoiled(
        finished, tmp_path / "nan.ckpt", lambda c: c["state_dict"]["dynamics.field.unit"].fill_(torch.nan)
    )
    with pytest.raises(UserError, match="expected finite weights; received nan or inf"):
        ahnn.load(finished, ckpt=str(path))


def test_a_training_begins_at_the_weights_of_another(finished, tmp_path, capfd):
    more = [*FIRST, f"weights={finished}", "trainer.max_epochs=1", f"run={tmp_path / 'more'}"]
    assert call("ahnn.train", *more, "optimizer.lr=1e-5", "scheduler=none") == 0
    before, after = (load_results(d).training["val_loss"] for d in (finished, tmp_path / "more"))
    assert after == pytest.approx(before, rel=1e-2)
    wrong = [*FIRST, f"weights={finished}", "model.network.width=9", f"run={tmp_path / 'wrong'}"]
    assert call("ahnn.train", *wrong) == 2
    assert "dynamics.network.width: expected 9, received 8" in capfd.readouterr().err
