"""Sweeps on a local Ray cluster of two workers, one of which is killed, with the extra `ray`."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from pathlib import Path

import pytest
from sweeps import SEARCH, assert_none_lost_or_doubled, start, states, trials

pytest.importorskip("ray", reason="the extra `ray` is needed")
RAY = ("hydra/launcher=ahnn_ray", "sleep=0.5")


def parent(pid: int) -> int:
    """Return the parent of a process."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def job_of(folder: Path) -> int:
    """Return the process of the job that writes to the log of a folder, as soon as there is one."""
    while True:
        for place in Path("/proc").glob("[0-9]*/fd/1"):
            try:
                if place.samefile(folder / "console.log"):
                    return int(place.parts[2])
            except OSError:  # it is gone, or there is no log yet
                continue
        time.sleep(0.01)


def swept_with_a_killed_worker(folder: Path, *arguments: str) -> tuple[int, str]:
    """Run a sweep, and kill the worker of its job 1 while the job runs; return exit code and output."""
    process = start(folder, *RAY, *arguments)
    job = job_of(folder / "1")
    worker = parent(parent(job))  # between them is the server that forks jobs
    assert Path(f"/proc/{worker}/cmdline").read_text().startswith("ray::")
    os.kill(worker, signal.SIGKILL)
    output, _ = process.communicate(timeout=300)
    return process.returncode, output


@pytest.mark.slow
def test_a_search_repeats_the_trial_of_a_killed_worker_once(tmp_path: Path):
    search = (*SEARCH, "hydra.sweeper.batch_size=2", "hydra.sweeper.n_trials=4")
    code, output = swept_with_a_killed_worker(tmp_path / "sweep", *search)
    assert code == 0, output
    assert "job #1 was killed by SIGKILL" in output
    found = trials(tmp_path / "sweep")
    assert_none_lost_or_doubled(found, 4)
    assert Counter(states(found)) == {"COMPLETE": 4, "FAIL": 1}
    assert [trial.number for trial in found if trial.state.name == "FAIL"] == [1]


@pytest.mark.slow
def test_a_grid_repeats_the_job_of_a_killed_worker_in_another(tmp_path: Path):
    folder = tmp_path / "grid"
    code, output = swept_with_a_killed_worker(folder, "x=0,1,2,3", "raising=[3]")
    assert code == 1
    assert "1 of 4 jobs failed" in output
    assert "job #3 ended with exit code 1" in output
    logs = [(folder / str(k) / "console.log").read_text() for k in range(4)]
    assert [logs[k].count(f"job {k} done") for k in range(4)] == [1, 1, 1, 0]
