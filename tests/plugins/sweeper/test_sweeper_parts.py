"""Parts of the sweeper by themselves: owners, counting, samplers, and the trial as a callback gets it."""

from __future__ import annotations

import os
from pathlib import Path

import hydra
import optuna
import pytest
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import DictConfig, OmegaConf
from optuna.trial import TrialState, create_trial
from sweeps import ROOT

from hydra_plugins.ahnn_sweeper import _owner
from hydra_plugins.ahnn_sweeper._ledger import allot, count
from hydra_plugins.ahnn_sweeper._progress import progress_line
from hydra_plugins.ahnn_sweeper._storage import resolved
from hydra_plugins.ahnn_sweeper._study import open_study, sampler
from hydra_plugins.ahnn_sweeper._trial import TrialCallback
from hydra_plugins.ahnn_sweeper.sweeper import AhnnOptunaSweeper


def running(**attributes: object) -> optuna.trial.FrozenTrial:
    return create_trial(state=TrialState.RUNNING, user_attrs=dict(attributes))


def test_a_process_is_alive_while_it_exists_and_is_the_same():
    host, pid, start, claimed = _owner.this_process().split("|")
    assert _owner.is_alive(running(asked_by=_owner.this_process()))
    assert not _owner.is_alive(running(asked_by=f"{host}|{pid}|1{start}|{claimed}"))  # the id was used again
    assert not _owner.is_alive(running(asked_by=f"{host}|{2**22 + 1}|{start}|{claimed}"))
    assert not _owner.is_alive(running())


def test_the_job_counts_once_it_runs():
    me = _owner.this_process()
    dead = me.replace(f"|{os.getpid()}|", f"|{2**22 + 1}|")
    assert not _owner.is_alive(running(asked_by=me, run_by=dead))
    assert _owner.is_alive(running(asked_by=dead, run_by=me))


def test_another_host_is_believed_as_long_as_its_lease(monkeypatch: pytest.MonkeyPatch):
    claimed = float(_owner.this_process().rpartition("|")[2])
    trial = running(asked_by=f"elsewhere|1|1|{claimed:.0f}", lease=claimed + 100)
    for later, alive in ((10, True), (240, True), (260, False)):
        monkeypatch.setattr(_owner.time, "time", lambda now=claimed + later: now)
        assert _owner.is_alive(trial) is alive


def test_a_retry_counts_in_the_place_of_its_orphan():
    study = optuna.create_study()
    study.add_trials([create_trial(value=2.0), create_trial(state=TrialState.FAIL)])
    study.enqueue_trial({}, user_attrs={"retry_of": 1})
    study.add_trial(create_trial(state=TrialState.PRUNED, value=1.0))
    counts = count(study.trials)
    assert counts == (1, 1, 0, 0, 1, 1)
    assert counts.taken == 3
    assert progress_line(study.trials, 4, "MINIMIZE").startswith(
        "sweep 2/4  best 2  running 0  pruned 1  failed 0"
    )


def test_no_two_trials_share_a_seed_and_a_restart_changes_nothing():
    config = OmegaConf.create({"_target_": "optuna.samplers.RandomSampler", "seed": 7})
    space = {"x": optuna.distributions.FloatDistribution(0, 1)}

    def draw(number: int) -> float:
        return optuna.create_study(sampler=sampler(config, number)).ask(space).params["x"]

    assert len({draw(number) for number in range(20)}) == 20
    assert draw(3) == draw(3)


def test_an_orphan_without_parameters_is_retried_with_some_of_its_own(tmp_path: Path):
    url = f"journal:///{tmp_path / 'study.journal'}"
    config = OmegaConf.create({"_target_": "optuna.samplers.RandomSampler", "seed": 7})
    space = {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}
    study = open_study(url, "sweep", "minimize", [])
    study.ask()  # its worker is killed before it has drawn, or has said who it is
    taken = allot(study, url, space, lambda number: sampler(config, number), total=3, limit=3)
    assert [trial.number for trial in taken] == [1, 2, 3]
    assert taken[0].user_attrs["retry_of"] == 0
    assert len({trial.params["x"] for trial in taken}) == 3


def test_storage_paths_are_absolute_and_schemes_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert resolved("sqlite:///study.db") == f"sqlite:///{tmp_path}/study.db"
    assert resolved("postgresql+psycopg://host/db") == "postgresql+psycopg://host/db"
    with pytest.raises(ValueError, match="sweeper storage: expected"):
        resolved("redis://host")


def test_the_pfl_callback_gets_the_trial_of_its_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("AHNN_CONF", str(ROOT / "conf"))
    url = f"journal:///{tmp_path / 'study.journal'}"
    trial = open_study(url, "s", "minimize", []).ask()
    node = f"{{_target_:hydra_plugins.ahnn_sweeper.load_trial,storage:'{url}',study_name:s,trial_id:0}}"
    folders = [f"hydra.sweep.dir={tmp_path}", f"hydra.runtime.output_dir={tmp_path}"]
    with hydra.initialize(version_base=None, config_path="toy_conf"):
        config = hydra.compose(
            "toy", ["sweep=quick", "model=hnn", f"trial={node}", *folders], return_hydra_config=True
        )
    HydraConfig.instance().set_config(config)
    callback = hydra.utils.instantiate(config.callbacks.pfl)
    callback.trial.report(0.5, 0)
    assert trial.study.trials[0].intermediate_values == {0: 0.5}
    assert callback.settings.target_epoch == config.trainer.max_epochs
    assert callback.record.group == "spring/hnn"
    assert callback.record.path == tmp_path / "pfl_record.jsonl"


def test_a_checked_job_finds_the_folder_that_its_search_names(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("AHNN_CONF", str(ROOT / "conf"))
    with hydra.initialize(version_base=None, config_path="toy_conf"):
        config = hydra.compose("toy", ["sweep=quick", "model=hnn"], return_hydra_config=True)
    before, seen = HydraConfig.instance().cfg, []

    def task(cfg: DictConfig) -> None:
        raise AssertionError(cfg)

    task.check = lambda cfg: seen.append(("hydra" in cfg, cfg.callbacks.pfl.record))  # pyright: ignore[reportFunctionMemberAccess]
    options = OmegaConf.to_container(config.hydra.sweeper, resolve=True)
    sweeper = AhnnOptunaSweeper(**{k: v for k, v in options.items() if k[0] != "_"})  # pyright: ignore
    sweeper.config, sweeper.task_function = config, task
    sweeper._check(config.copy())
    assert seen == [(False, "runs/sweeps/quick_spring_hnn/pfl_record.jsonl")]
    assert HydraConfig.instance().cfg is before


@pytest.mark.parametrize("variable", ["LOCAL_RANK", "SLURM_PROCID"])
def test_only_the_first_process_of_a_job_speaks_and_a_pruned_one_ends_in_peace(monkeypatch, variable):
    monkeypatch.setenv(variable, "1")
    callback = TrialCallback()
    trial = {"storage": "journal:////nowhere/study.journal", "study_name": "x", "trial_id": 0}
    config = OmegaConf.create({"trial": trial})
    callback.on_job_start(config)
    job = JobReturn(status=JobStatus.FAILED)
    job.return_value = optuna.TrialPruned("stopped")
    callback.on_job_end(config, job)
    assert job.status is JobStatus.COMPLETED
    job.status, job.return_value = JobStatus.FAILED, RuntimeError("broken")
    callback.on_job_end(config, job)
    assert job.status is JobStatus.FAILED
