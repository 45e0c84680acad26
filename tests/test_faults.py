"""What a fault campaign found: folders that are not ours, full disks, and odd environments."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import torch
from entry import FIRST, SMALL, call, forked, started

from ahnn.checkpoints import read_checkpoint
from ahnn.errors import UserError
from ahnn.evaluation import load_results
from ahnn.training.checkpoint_io import AtomicCheckpointIO


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# Folders


def test_a_refused_command_removes_nothing_that_it_did_not_make(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "other"
    (other / ".hydra").mkdir(parents=True)
    (other / ".hydra" / "config.yaml").write_text("foreign: 1")
    (other / "data.txt").write_text("dear")
    (tmp_path / "empty").mkdir()
    before = content(tmp_path)
    for run in ("other", ".", "empty", str(other)):
        assert call("ahnn.train", *SMALL, f"run={run}", "seed=x") == 2
        assert capfd.readouterr().err.startswith("ahnn: seed")
    assert content(tmp_path) == before
    assert (tmp_path / "empty").is_dir()


@pytest.mark.slow
def test_a_refused_command_leaves_a_finished_run_as_it_was(tmp_path):
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}") == 0
    before = content(tmp_path)
    changed = ("optimizer.lr=1", "+trainer.gradient_clip_val=1", "callbacks.best.monitor=val/one_step")
    for wrong in (["seed=x"], [], *(["ckpt=last", change] for change in changed)):
        assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}", *wrong) == 2
        assert content(tmp_path) == before


@pytest.mark.slow
def test_two_runs_of_one_second_have_a_folder_each(tmp_path):
    both = [started(tmp_path, *FIRST) for _ in range(2)]
    said = [job.communicate(timeout=120)[0] for job in both]
    assert [job.returncode for job in both] == [0, 0], said
    assert len(list(tmp_path.glob("runs/*/*/metrics.json"))) == 2


def test_a_folder_that_another_process_writes_into_is_refused(tmp_path):
    from ahnn.files import claimed

    with claimed(tmp_path), pytest.raises(UserError, match="no other process uses"), claimed(tmp_path):
        pytest.fail("claimed twice")
    with claimed(tmp_path):  # free again
        assert (tmp_path / ".claim").exists()
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_was_moved_keeps_its_best_weights(tmp_path):
    run = [*FIRST, "trainer.max_epochs=4", "optimizer.lr=0.3"]
    cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.steps=25", "+callbacks.cut.ctrl_c=true"]
    assert call("ahnn.train", *run, f"run={tmp_path / 'whole'}") == 0
    assert call("ahnn.train", *run, f"run={tmp_path / 'cut'}", *cut) == 130
    (tmp_path / "cut").rename(tmp_path / "moved")
    assert call("ahnn.train", *run, f"run={tmp_path / 'moved'}", "ckpt=last") == 0
    whole, moved = (
        read_checkpoint(tmp_path / name / "checkpoints" / "best.ckpt") for name in ("whole", "moved")
    )
    assert whole["epoch"] == moved["epoch"]
    assert all(torch.equal(v, moved["state_dict"][k]) for k, v in whole["state_dict"].items())


# Files


def test_a_full_disk_leaves_the_checkpoint_that_was_there(tmp_path, monkeypatch):
    io, path = AtomicCheckpointIO(), tmp_path / "best.ckpt"
    io.save_checkpoint({"state_dict": {}, "ahnn": {}, "n": 1}, path)

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        io.save_checkpoint({"state_dict": {}, "ahnn": {}, "n": 2}, path)
    assert read_checkpoint(path)["n"] == 1
    assert {p.name for p in tmp_path.iterdir()} == {"best.ckpt", ".ahnn-files"}


def test_a_full_disk_in_a_training_is_one_message_that_names_the_file(tmp_path, monkeypatch, capfd):
    def full(_):
        raise OSError(28, "No space left on device")

    assert call("ahnn.train", *FIRST, "trainer.max_epochs=1", f"run={tmp_path / 'cached'}") == 0
    monkeypatch.setattr(os, "fsync", full)
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}") == 2
    last = capfd.readouterr().err.splitlines()[-1]
    assert last == f"ahnn: file {tmp_path / 'run' / 'config.yaml'}: No space left on device"


def test_a_training_without_events_says_nothing_of_tensorboard(tmp_path, capfd):
    few = [*FIRST, "trainer.max_epochs=1"]
    assert call("ahnn.train", *few, f"run={tmp_path / 'without'}") == 0
    assert "TensorBoard" not in capfd.readouterr().err
    few = ["logger=tensorboard" if word == "logger=none" else word for word in few]
    assert call("ahnn.train", *few, f"run={tmp_path / 'with'}") == 0
    assert "TensorBoard: tensorboard --logdir" in capfd.readouterr().err


def test_files_have_the_permissions_that_the_user_chose(tmp_path):
    from ahnn.files import write_atomically

    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "shared", b"x")
    finally:
        os.umask(before)
    assert (tmp_path / "shared").stat().st_mode & 0o777 == 0o640


def test_a_training_that_ends_before_its_first_validation_is_judged(tmp_path):
    assert call("ahnn.train", *FIRST, "+trainer.max_steps=3", f"run={tmp_path / 'run'}") == 0
    assert load_results(tmp_path / "run").training["steps"] == 3
    assert call("ahnn.train", *FIRST, "callbacks.best=null", f"run={tmp_path / 'none'}") == 0


ODD = ("MPLBACKEND=nonsense", "RANK=x", "TORCH_LOGS=")


@pytest.mark.parametrize("odd", [*ODD, pytest.param("LOCAL_RANK=x", marks=pytest.mark.slow)])
@pytest.mark.sampled(3)
def test_a_library_that_cannot_be_imported_is_one_message(tmp_path, monkeypatch, odd):
    monkeypatch.setenv(*odd.split("="))
    job = started(tmp_path, *FIRST, f"run={tmp_path / 'run'}")
    said, _ = job.communicate(timeout=60)
    assert job.returncode == 2
    assert "ahnn: environment: cannot import a library (" in said
    assert "Traceback" not in said


def closed() -> None:
    """Close standard input and output, which are then None, as in an interpreter that starts without."""
    for number in (0, 1):
        os.close(number)
    sys.stdin = sys.stdout = sys.__stdin__ = sys.__stdout__ = None


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_command_needs_no_streams(tmp_path):
    few = [*FIRST, "trainer.max_epochs=1", f"run={tmp_path / 'run'}"]
    _, status = os.waitpid(forked("ahnn.train", *few, before=closed), 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert (tmp_path / "run" / "metrics.json").exists()
