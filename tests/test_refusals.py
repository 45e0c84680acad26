"""What cannot work is refused at once: before data are generated, before the first trial of a search."""

from __future__ import annotations

import pytest
from entry import FIRST, call

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
@pytest.mark.sampled(2)
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


REFUSED = {
    "recipe=second_order integrator=gl4": "integrator: expected an explicit method",
    "+plugins.x._target_=fractions.Fraction": "plugins.x: expected EvaluationPlugin; received Fraction",
    "callbacks=[default,pfl] callbacks.pfl.monitor=nonsense": "callbacks.pfl.monitor: expected one of val/",
    "optimizer=levenberg_marquardt": "data.precision: expected 64, for the precision",
    "hamiltonian=central_body": "central_body: expected at least 2 degrees of freedom",
    "model.falloff=3": "falloff: expected 0, since generic has no V(q); received 3",
    "data.emphasis=1e30": "data.emphasis: expected float from 0 to 4; received 1e+30",
    "model.network.width=1000000": "width and depth: expected weights that fit in",
    "model.network.depth=10000000": "width and depth: expected weights that fit in",
    "data.trajectories=1000000000000": "data.trajectories, system.steps: expected trajectories that fit in",
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
@pytest.mark.sampled(2)
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
