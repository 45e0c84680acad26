"""What a fault campaign found: folders that are not ours, signals, sizes, and settings that cannot work."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from entry import SMALL, call

import ahnn
from ahnn.checkpoints import read_checkpoint
from ahnn.errors import UserError
from ahnn.evaluation import load_results
from ahnn.training.checkpoint_io import AtomicCheckpointIO

FIRST = [*SMALL, "recipe=first_order", "evaluation=scores"]


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def started(folder: Path, *overrides: str) -> subprocess.Popen:
    """A training in a process of its own."""
    command = [sys.executable, "-m", "ahnn.train", *overrides]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        command, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


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


def test_a_refused_command_leaves_a_finished_run_as_it_was(tmp_path):
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}") == 0
    before = content(tmp_path)
    changed = ("optimizer.lr=1", "+trainer.gradient_clip_val=1", "callbacks.best.monitor=val/one_step")
    for wrong in (["seed=x"], [], *(["ckpt=last", change] for change in changed)):
        assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}", *wrong) == 2
        assert content(tmp_path) == before


def test_two_runs_of_one_second_have_a_folder_each(tmp_path):
    both = [started(tmp_path, *FIRST) for _ in range(2)]
    said = [job.communicate(timeout=120)[0] for job in both]
    assert [job.returncode for job in both] == [0, 0], said
    assert len(list(tmp_path.glob("runs/*/*/metrics.json"))) == 2


def test_a_folder_that_another_process_writes_into_is_refused(tmp_path):
    from ahnn.files import claimed

    with claimed(tmp_path), pytest.raises(UserError, match="another process writes into"), claimed(tmp_path):
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


# Signals


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_scheduler_that_ends_a_training_loses_nothing(tmp_path, number, code):
    run = [*FIRST, "trainer.max_epochs=2000", "callbacks.last.every=100000", f"run={tmp_path / 'run'}"]
    job = started(tmp_path, *run)
    last = tmp_path / "run" / "checkpoints" / "last.ckpt"
    while not last.exists():
        assert job.poll() is None
        time.sleep(0.05)
    job.send_signal(number)
    said, _ = job.communicate(timeout=60)
    assert job.returncode == code
    assert f"stopped by {number.name}; resume with the same command and run=" in said
    assert "Traceback" not in said
    assert read_checkpoint(last)["global_step"] > 0


@pytest.mark.parametrize("moment", [0.02, 0.1, 0.3, 1.0, 2.0])
def test_ctrl_c_is_no_traceback_however_early(tmp_path, moment):
    job = started(tmp_path, *FIRST, "trainer.max_epochs=2000")
    time.sleep(moment)
    job.send_signal(signal.SIGINT)
    said, _ = job.communicate(timeout=60)
    assert job.returncode in (130, -signal.SIGINT)
    assert "Traceback" not in said


def test_ctrl_c_in_a_search_says_that_the_search_goes_on(tmp_path):
    search = ["-m", "sweep=quick", "hydra/launcher=ahnn_process", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    job = started(tmp_path, *search)
    while not (tmp_path / "sweep" / "0" / "console.log").exists():
        assert job.poll() is None
        time.sleep(0.05)
    job.send_signal(signal.SIGINT)
    said, _ = job.communicate(timeout=60)
    assert job.returncode == 130
    assert "ahnn: stopped by Ctrl-C; the same command continues the search\n" in said
    assert "from the beginning" not in said


def test_a_scheduler_that_ends_a_sweep_ends_all_of_it(tmp_path):
    jobs = ["-m", "seed=7,201", *FIRST, "trainer.max_epochs=2000", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    job = started(tmp_path, *jobs)
    while not (tmp_path / "sweep" / "0" / "checkpoints" / "last.ckpt").exists():
        assert job.poll() is None
        time.sleep(0.05)
    job.send_signal(signal.SIGTERM)
    job.communicate(timeout=60)
    assert job.returncode == 143
    assert not (tmp_path / "sweep" / "1" / "checkpoints").exists()


# Checkpoints


def test_a_full_disk_leaves_the_checkpoint_that_was_there(tmp_path, monkeypatch):
    io, path = AtomicCheckpointIO(), tmp_path / "best.ckpt"
    io.save_checkpoint({"state_dict": {}, "ahnn": {}, "n": 1}, path)

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        io.save_checkpoint({"state_dict": {}, "ahnn": {}, "n": 2}, path)
    assert read_checkpoint(path)["n"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["best.ckpt"]


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
    assert call("ahnn.train", *few, "logger=tensorboard", f"run={tmp_path / 'with'}") == 0
    assert "TensorBoard: tensorboard --logdir" in capfd.readouterr().err


def test_files_have_the_permissions_that_the_user_chose(tmp_path):
    from ahnn.files import write_atomically

    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "shared", b"x")
    finally:
        os.umask(before)
    assert (tmp_path / "shared").stat().st_mode & 0o777 == 0o640


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults") / "run"
    assert call("ahnn.train", *FIRST, f"run={folder}") == 0
    return folder


def spoiled(finished, path, change):
    """A checkpoint of the finished run with something else in it."""
    found = torch.load(finished / "checkpoints" / "last.ckpt", weights_only=True)
    change(found)
    torch.save(found, path)
    return path


SPOILED = {
    "a moment of another shape": (
        lambda c: c["optimizer_states"][0]["state"][0].update(exp_avg=torch.zeros(3)),
        "received others of optimizer_states.0.state.0.exp_avg",
    ),
    "a step that is no number": (
        lambda c: c["optimizer_states"][0]["state"][0].update(step=torch.zeros(10_000)),
        "received others of optimizer_states.0.state.0.step",
    ),
    "a step of another type": (
        lambda c: c["optimizer_states"][0]["state"][0].update(step=torch.zeros((), dtype=torch.int64)),
        "received others of optimizer_states.0.state.0.step",
    ),
    "a tensor that is no moment": (
        lambda c: c["optimizer_states"][0]["state"][0].update(max_exp_avg_sq=torch.zeros(3)),
        "received others of optimizer_states.0.state.0.max_exp_avg_sq",
    ),
    "a tensor in place of a number": (
        lambda c: c["optimizer_states"][0]["param_groups"][0].update(lr=torch.ones(3)),
        "received others of optimizer_states.0.param_groups.0.lr",
    ),
    "the state of a parameter that is not there": (
        lambda c: c["optimizer_states"][0]["state"].update({99: {"exp_avg": torch.zeros(3)}}),
        "received others of optimizer_states.0.state.99.exp_avg",
    ),
    "a missing moment": (
        lambda c: c["optimizer_states"][0]["state"][0].pop("exp_avg"),
        "received others of optimizer_states.0.state.0.exp_avg",
    ),
    "a missing option": (
        lambda c: c["optimizer_states"][0]["param_groups"][0].pop("betas"),
        "received one that is not whole: KeyError('betas')",
    ),
    "a parameter too many": (
        lambda c: c["optimizer_states"][0]["param_groups"][0]["params"].append(99),
        "received one that is not whole: ValueError",
    ),
    "no progress": (
        lambda c: c["loops"]["fit_loop"].update(epoch_progress={}),
        "received one that is not whole: KeyError('total')",
    ),
    "no best value": (
        lambda c: c["callbacks"].update(BestPoint={"x": 1}),
        "received one that is not whole: KeyError('best')",
    ),
    "a moment that is no tensor": (
        lambda c: c["optimizer_states"][0]["state"][0].update(exp_avg=None),
        "received others of optimizer_states.0.state.0.exp_avg",
    ),
    "a weight of another shape": (
        lambda c: c["state_dict"].update({"loss.unit": torch.ones(7)}),
        "received others of loss.unit",
    ),
    "a weight too many": (lambda c: c["state_dict"].update({"x": torch.ones(1)}), "received others of x"),
    "steps that are no number": (
        lambda c: c.update(global_step=torch.tensor(torch.nan)),
        "received one without global_step",
    ),
    "a version that is none": (
        lambda c: c.update({"pytorch-lightning_version": "x"}),
        "received one that is not whole: ",
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


def test_a_finished_run_has_no_steps_left(finished, tmp_path, capfd):
    shutil.copytree(finished, tmp_path / "run")
    capfd.readouterr()
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}", "ckpt=last") == 0
    assert ": 0 optimiser steps of 16 windows in 0 epochs, about 0 s" in capfd.readouterr().err


WRONG_JOBS = {
    "callbacks.pfl.patience=-1": "did you mean 'callbacks.pfl",
    "callbacks.pfl.top_k=-1": "top_k: expected int >= 1",
    "callbacks.pfl.monitor=nonsense": "callbacks.pfl.monitor: expected one of val/loss, val/one_step",
    "data.trajectories=-1": "data.trajectories: expected int >= 1",
    "callbacks.best.monitor=nonsense": "callbacks.best.monitor: expected one of val/loss, val/one_step",
    "data.precision=7": "data.precision: expected one of 32, 64; received 7",
    "+trainer.strategy=ddp": "received ddp. Use trainer=ddp",
}


@pytest.mark.parametrize("launcher", ["basic", "ahnn_process"])
@pytest.mark.parametrize("mistake", WRONG_JOBS)
def test_a_sweep_checks_one_job_whole_before_its_first_trial(mistake, launcher, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path / "cache"))
    given = ["-m", "sweep=quick", f"hydra/launcher={launcher}", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    assert call("ahnn.train", *given, mistake) == 2
    out, err = capfd.readouterr()
    assert WRONG_JOBS[mistake] in err
    assert err.count("\n") == 1
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []


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
    assert "it belongs to another training" in capfd.readouterr().err


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


def test_a_training_that_ends_before_its_first_validation_is_judged(tmp_path):
    assert call("ahnn.train", *FIRST, "+trainer.max_steps=3", f"run={tmp_path / 'run'}") == 0
    assert load_results(tmp_path / "run").training["steps"] == 3
    assert call("ahnn.train", *FIRST, "callbacks.best=null", f"run={tmp_path / 'none'}") == 0


REFUSED = {
    "recipe=second_order integrator=gl4": "integrator: expected an explicit method",
    "+plugins.x._target_=fractions.Fraction": "plugins.x: expected EvaluationPlugin; received Fraction",
    "callbacks=[default,pfl] callbacks.pfl.monitor=nonsense": "callbacks.pfl.monitor: expected one of val/",
    "optimizer=levenberg_marquardt": "data.precision: expected 64, for the digits",
    "hamiltonian=central_body": "central_body: expected at least 2 degrees of freedom",
    "data.emphasis=1e30": "data.emphasis: expected float from 0 to 4; received 1e+30",
    "model.network.width=1000000": "width and depth: expected weights that fit into",
    "model.network.depth=10000000": "width and depth: expected weights that fit into",
    "data.trajectories=1000000000000": "data.trajectories, system.steps: expected trajectories that fit into",
    "+trainer.check_val_every_n_epoch=0": "check_val_every_n_epoch: expected int >= 1; received 0",
    "+trainer.strategy=ddp": "received ddp. Use trainer=ddp",
    "+trainer.fast_dev_run=true": "trainer.fast_dev_run: expected False",
    "callbacks.best.monitor=foo": "callbacks.best.monitor: expected one of val/loss, val/one_step",
    "+callbacks.best.save_top_k=3": "callbacks.best: unknown key 'save_top_k'",
    "+callbacks.best.filename=x": "callbacks.best: unknown key 'filename'",
    "plugins=ukf_tuned plugins.ukf.tuning.steps=0": "tuning.steps: expected int >= 1",
    "folder=null": "folder: expected str; received None",
    "system=[molniya,1]": "system: expected one of",
    "seed=99999999999999999999999": "seed: expected int from 0 to 4294967295",
    "system.dt=1e9": "Shorten system.dt",
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_cannot_work_is_refused_at_once(mistake, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path / "cache"))  # nothing may be generated either
    given = mistake.split()
    keys = [g.split("=")[0] for g in given]
    kept = [o for o in FIRST if o.split("=")[0] not in keys and "width" not in o]
    assert call("ahnn.train", *kept, f"run={tmp_path / 'run'}", *given) == 2
    err = capfd.readouterr().err
    assert REFUSED[mistake] in err
    assert err.count("\n") == 1
    generated = {"cache"} if mistake == "system.dt=1e9" else set()  # its accuracy shows in what it generates
    assert {path.name for path in tmp_path.iterdir()} == generated


def test_a_cluster_that_asks_for_several_tasks_is_one_message(tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("SLURM_NTASKS", "4")
    assert call("ahnn.train", *FIRST, f"run={tmp_path / 'run'}") == 2
    assert "ntasks" in capfd.readouterr().err


@pytest.mark.parametrize("odd", ["MPLBACKEND=nonsense", "RANK=x", "LOCAL_RANK=x", "TORCH_LOGS="])
def test_a_library_that_cannot_be_imported_is_one_message(tmp_path, monkeypatch, odd):
    monkeypatch.setenv(*odd.split("="))
    job = started(tmp_path, *FIRST, f"run={tmp_path / 'run'}")
    said, _ = job.communicate(timeout=60)
    assert job.returncode == 2
    assert "ahnn: environment: a library cannot be imported: " in said
    assert "Traceback" not in said


def test_a_command_needs_no_streams(tmp_path):
    words = [sys.executable, "-m", "ahnn.train", *FIRST, "trainer.max_epochs=1", f"run={tmp_path / 'run'}"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    shell = ["bash", "-c", 'exec "$@" >&- <&-', "bash", *words]
    done = subprocess.run(shell, stderr=subprocess.PIPE, text=True, env=env, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "metrics.json").exists()
