"""Kills: of the sweep, of a job, of one worker among several. No trial is lost or doubled."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

import pytest
from sweeps import SEARCH, assert_none_lost_or_doubled, start, states, sweep, trials


def kill_after(folder: Path, jobs: int, seconds: float, *arguments: str) -> None:
    """Start a sweep, and kill it some seconds after a given number of its jobs have begun."""
    process = start(folder, *arguments)
    while not (folder / str(jobs - 1)).exists():
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.01)
    time.sleep(seconds)
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_a_killed_sweep_goes_on_where_it_was(tmp_path: Path):
    folder = tmp_path / "sweep"
    arguments = (*SEARCH, "hydra.sweeper.n_trials=8", "sleep=0.05")
    kill_after(folder, 3, 0.07, *arguments)
    code, output = sweep(folder, *arguments)
    assert code == 0, output
    assert_none_lost_or_doubled(trials(folder), 8)


@pytest.mark.slow
@pytest.mark.parametrize("tenths", range(10))
def test_a_killed_sweep_goes_on_at_any_moment(tmp_path: Path, tenths: int):
    folder = tmp_path / "sweep"
    arguments = (*SEARCH, "hydra.sweeper.n_trials=8", "sleep=0.02")
    for jobs in (2, 5):
        kill_after(folder, jobs, 0.013 * tenths, *arguments)
    code, output = sweep(folder, *arguments)
    assert code == 0, output
    assert_none_lost_or_doubled(trials(folder), 8)


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "ahnn_process"])
def test_a_killed_job_is_retried_once_and_stops_nothing(tmp_path: Path, launcher: str):
    folder = tmp_path / "sweep"
    parallel = (f"hydra/launcher={launcher}", "hydra.launcher.n_jobs=2", "hydra.sweeper.batch_size=2")
    code, output = sweep(folder, *SEARCH, *parallel, "hydra.sweeper.n_trials=2", "killed=[1]")
    assert code == 0, output
    found = trials(folder)
    assert_none_lost_or_doubled(found, 2)
    failed = {trial.number for trial, state in zip(found, states(found), strict=True) if state == "FAIL"}
    assert {1} <= failed <= ({0, 1} if launcher == "joblib" else {1})  # joblib gives up the whole batch
    retries = {trial.user_attrs["retry_of"]: trial for trial in found if "retry_of" in trial.user_attrs}
    assert {number: trial.params for number, trial in retries.items()} == {n: found[n].params for n in failed}


@pytest.mark.slow
def test_a_job_that_is_killed_twice_fails(tmp_path: Path):
    folder = tmp_path / "sweep"
    code, output = sweep(
        folder, *SEARCH, "hydra/launcher=ahnn_process", "hydra.sweeper.n_trials=2", "killed=[0,1,2]"
    )
    assert code == 1
    assert "not retried again" in output
    found = trials(folder)
    assert_none_lost_or_doubled(found, 2)
    assert Counter(states(found)) == {"FAIL": 3, "COMPLETE": 1}


def workers_share(folder: Path, count: int, total: int, *arguments: str, storage: str | None = None) -> None:
    """Let workers share a study, kill one of them on the way, and check the result."""
    command = (*SEARCH, f"hydra.sweeper.n_trials={total}", "sleep=0.01", *arguments)
    workers = [start(folder, *command) for _ in range(count)]
    while not (folder / str(total // 3)).exists():
        assert workers[0].poll() is None, workers[0].communicate()[0]
        time.sleep(0.02)
    workers[-1].kill()
    outputs = [worker.communicate(timeout=300)[0] for worker in workers]
    assert [worker.returncode for worker in workers[:-1]] == [0] * (count - 1), outputs
    found = trials(folder, storage)
    assert_none_lost_or_doubled(found, total)
    marks = [trial.user_attrs.get("asked_by") for trial in found]  # none where the kill came before it
    assert len({mark.rpartition("|")[0] for mark in marks if mark}) == count


def test_two_workers_share_a_journal_and_one_is_killed(tmp_path: Path):
    workers_share(tmp_path / "sweep", 2, 9)


@pytest.mark.slow
def test_two_workers_share_sqlite(tmp_path: Path):
    storage = f"sqlite:///{tmp_path / 'study.db'}"
    workers_share(tmp_path / "sweep", 2, 12, f"hydra.sweeper.storage={storage}", storage=storage)


@pytest.mark.slow
def test_two_workers_share_postgresql(tmp_path: Path, postgres: str):
    workers_share(tmp_path / "sweep", 2, 9, f"hydra.sweeper.storage={postgres}", storage=postgres)


@pytest.mark.slow
def test_four_workers_run_two_hundred_trials_on_a_journal(tmp_path: Path):
    workers_share(tmp_path / "sweep", 4, 200)


@pytest.mark.slow
def test_four_workers_run_two_hundred_trials_on_postgresql(tmp_path: Path, postgres: str):
    options = (f"hydra.sweeper.storage={postgres}", "hydra.sweeper.study_name=four")
    folder = tmp_path / "sweep"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sweeps.trials.__defaults__", (None, "four"))
        workers_share(folder, 4, 200, *options, storage=postgres)


@pytest.mark.slow
def test_a_plain_grid_survives_a_failed_and_a_killed_job(tmp_path: Path):
    folder = tmp_path / "grid"
    arguments = ("hydra/launcher=ahnn_process", "hydra.launcher.n_jobs=2", "raising=[1]", "killed=[2]")
    code, output = sweep(folder, "x=0,1,2,3,4", *arguments)
    assert code == 1
    assert "2 of 5 jobs failed" in output
    assert "job #1 ended with exit code 1" in output
    assert "job #2 was killed by SIGKILL" in output
    done = [k for k in range(5) if f"job {k} done" in (folder / str(k) / "console.log").read_text()]
    assert done == [0, 3, 4]
