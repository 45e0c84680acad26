"""Stopped trainings, of one run, of several seeds and of a sweep: what is said, and how they go on."""

from __future__ import annotations

import pytest
import torch
from entry import SMALL, call


@pytest.fixture
def no_evaluation(monkeypatch):
    """The evaluation after a training has tests of its own."""
    monkeypatch.setattr("ahnn.jobs.closing.judge", lambda *_, **__: 0.0)


@pytest.mark.usefixtures("no_evaluation")
def test_ctrl_c_says_how_to_go_on_and_a_run_is_not_replaced(tmp_path, capfd):
    run = [*SMALL, "budget=smoke", "recipe=first_order", f"run={tmp_path}"]
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.ctrl_c=true"]
    assert call("ahnn.train", *run, *cut, "+callbacks.cut.steps=5") == 130
    err = capfd.readouterr().err
    assert "no checkpoint yet: repeating the command starts from the beginning" in err
    assert call("ahnn.train", *run, *cut, "+callbacks.cut.steps=15") == 130
    err = capfd.readouterr().err
    assert f"ahnn: stopped by Ctrl-C; resume with the same command and run={tmp_path} ckpt=last\n" in err
    assert "Traceback" not in err
    assert "Error" not in err

    before = {path: path.read_bytes() for path in (tmp_path / "checkpoints").iterdir()}
    assert call("ahnn.train", *run) == 2
    err = capfd.readouterr().err
    assert "best.ckpt, last.ckpt. Resume with ckpt=last, or choose another run=" in err
    assert {path: path.read_bytes() for path in (tmp_path / "checkpoints").iterdir()} == before
    assert call("ahnn.train", *run, "ckpt=last") == 0


@pytest.mark.usefixtures("no_evaluation")
def test_members_that_are_stopped_before_their_first_checkpoint_begin_again(tmp_path, capfd):
    run = [*SMALL, "budget=smoke", "recipe=first_order", "members=2", f"run={tmp_path}"]
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.ctrl_c=true"]
    assert call("ahnn.train", *run, *cut, "+callbacks.cut.steps=5") == 130
    said = capfd.readouterr().err
    assert "no checkpoint yet: repeating the command starts from the beginning" in said
    assert call("ahnn.train", *run, *cut, "+callbacks.cut.steps=15") == 130
    assert f"resume with the same command and run={tmp_path} ckpt=last\n" in capfd.readouterr().err
    assert call("ahnn.train", *run, "ckpt=last") == 0


@pytest.mark.usefixtures("no_evaluation")
def test_of_several_seeds_one_that_is_trained_stops_all_before_the_first(tmp_path, capfd):
    run = [*SMALL, "budget=smoke", "recipe=first_order", "trainer.max_epochs=1", f"run={tmp_path}"]
    assert call("ahnn.train", *run, "seeds=[201]") == 0
    assert call("ahnn.train", *run, "seeds=[7,201]") == 2
    assert f"run {tmp_path / 'seed_201'}: expected a folder without checkpoints" in capfd.readouterr().err
    assert not (tmp_path / "seed_7").exists()
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.ctrl_c=true", "+callbacks.cut.steps=20"]
    more = ["trainer.max_epochs=3", *cut]
    assert call("ahnn.train", *run, *more, "seeds=[7,719]") == 130
    assert f"resume with the same command and run={tmp_path} ckpt=last\n" in capfd.readouterr().err
    assert call("ahnn.train", *run, "trainer.max_epochs=3", "seeds=[7,719]", "ckpt=last") == 0
    assert (tmp_path / "seed_719" / "checkpoints" / "last.ckpt").exists()


@pytest.mark.usefixtures("no_evaluation")
def test_a_sweep_that_was_stopped_goes_on_and_begins_what_had_not_begun(tmp_path, capfd):
    sweep = ["-m", *SMALL, "seed=7,201", "budget=smoke", "recipe=first_order", "trainer.max_epochs=3"]
    sweep += [f"run={tmp_path / 'all'}"]
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.ctrl_c=true", "+callbacks.cut.steps=20"]
    assert call("ahnn.train", *sweep, *cut) == 130
    assert f"resume with the same command and run={tmp_path / 'all'} ckpt=last\n" in capfd.readouterr().err
    assert not (tmp_path / "all" / "1" / "checkpoints").exists()
    assert call("ahnn.train", *sweep) == 2
    assert "Resume with ckpt=last" in capfd.readouterr().err
    assert call("ahnn.train", *sweep, "ckpt=last") == 0
    for job in "01":
        last = tmp_path / "all" / job / "checkpoints" / "last.ckpt"
        assert torch.load(last, weights_only=True)["epoch"] == 2
