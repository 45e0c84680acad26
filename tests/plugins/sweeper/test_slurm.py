"""What docs/how_to/cluster.md prints for Slurm, run on a cluster of one node with small trainings."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest
import torch
from cluster import PROGRAMS, cluster, program, said, until
from entry import SMALL
from sweeps import ROOT, assert_none_lost_or_doubled, states, trials

from ahnn.checkpoints import read_checkpoint

MISSING = [name for name in PROGRAMS if program(name) is None]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}; apt-get install slurm-wlm"),
]
SECTION = (
    (ROOT / "docs" / "how_to" / "cluster.md").read_text().partition("### Slurm\n")[2].partition("\n## ")[0]
)
TRAINING = [*SMALL, "recipe=first_order", "evaluation=scores", "system=mass_spring"]
SEARCH = [*TRAINING, "model.network.depth=range(1,3)", "hydra.sweeper.study_name=slurm", "seeds=null"]


@pytest.fixture(scope="module")
def slurm():
    """Environment of a user of the cluster, with this interpreter as `python`."""
    with cluster() as env:
        paths = [str(ROOT), str(ROOT / "plugins"), *filter(None, [os.environ.get("PYTHONPATH")])]
        folder = str(Path(sys.executable).parent)
        yield env | {"PATH": f"{folder}:{env['PATH']}", "PYTHONPATH": ":".join(paths)}


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder to work in, with the scripts that the document prints."""
    for name, text in re.findall(r"`(\w+\.sh)`:\n\n```bash\n(.*?)```", SECTION, re.DOTALL):
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def printed(start, database=""):
    """Return the words of the command in the document that begins with some, with a database that exists."""
    lines = re.sub(r"postgresql\+\S+", database, SECTION.replace("\\\n", " ")).splitlines()
    return shlex.split(next(line for line in lines if line.startswith(start)))


def state(env, job):
    """Return the state of a job and how often it was requeued."""
    shown = said(env, "scontrol", "show", "job", job)
    return re.search(r"JobState=(\w+)", shown)[1], int(re.search(r"Restarts=(\d+)", shown)[1])


def submitted(env, command, more):
    """Submit a job and return its number."""
    return said(env, "sbatch", "--parsable", *command[1:], *more).strip()


def started(env, more):
    """Submit a training, wait for its first checkpoint, and return its number and that checkpoint."""
    job = submitted(env, printed("sbatch train.sh"), more)
    last = Path(f"runs/slurm_{job}/checkpoints/last.ckpt")
    until(last.exists)
    return job, last


def again_at_once(env, job):
    """Wait until a job is queued again, and spare the two minutes that Slurm then waits."""
    until(lambda: state(env, job) == ("PENDING", 1))
    said(env, "scontrol", "update", f"jobid={job}", "StartTime=now")


@pytest.mark.parametrize("cut", [["scancel", "--signal=TERM"], ["scontrol", "requeue"]], ids=" ".join)
def test_a_requeued_training_ends_with_the_same_bits(slurm, desk, cut):
    more = [*TRAINING, "trainer.max_epochs=60", "data.seed=1"]
    job, last = started(slurm, more)
    said(slurm, *cut, job)
    again_at_once(slurm, job)
    log = (desk / f"slurm-{job}.out").read_text()
    assert "stopped by SIGTERM; resume with the same command" in log
    done = read_checkpoint(last)["global_step"]
    assert 0 < done < 600
    until(lambda: state(slurm, job)[0] not in ("PENDING", "RUNNING", "COMPLETING"))
    assert state(slurm, job) == ("COMPLETED", 1)
    assert read_checkpoint(last)["global_step"] == 600
    assert "srun" not in said(slurm, "bash", "-c", "python -m ahnn.train $0 $@ run=whole 2>&1", *more)
    whole = read_checkpoint(Path("whole/checkpoints/last.ckpt"))["state_dict"]
    cut_off = read_checkpoint(last)["state_dict"]
    assert all(torch.equal(whole[name], cut_off[name]) for name in whole)


def test_a_cancelled_training_keeps_its_checkpoint_and_is_not_requeued(slurm, desk):
    job, last = started(slurm, [*TRAINING, "trainer.max_epochs=3000", "callbacks.last.every=100000"])
    said(slurm, "scancel", job)
    until(lambda: state(slurm, job)[0] == "CANCELLED")
    until(lambda: "stopped by SIGTERM; resume with the same" in (desk / f"slurm-{job}.out").read_text())
    assert state(slurm, job) == ("CANCELLED", 0)
    assert read_checkpoint(last)["global_step"] > 0


def test_two_tasks_are_the_two_devices_of_one_training(slurm, desk):
    job = submitted(slurm, printed("sbatch --ntasks"), TRAINING)
    until(lambda: state(slurm, job)[0] not in ("PENDING", "RUNNING", "COMPLETING"))
    assert state(slurm, job)[0] == "COMPLETED"
    (only,) = (desk / "runs").iterdir()
    assert only.name == f"slurm_{job}"
    assert (desk / f"slurm-{job}.out").read_text().count("results: ") == 1


def test_workers_share_a_search_and_one_is_requeued(slurm, desk, postgres):
    command = printed("sbatch --array", postgres)
    assert command[1] == "--array=1-8"
    command[1] = "--array=1-2"
    small = [*SEARCH, "hydra.sweeper.n_trials=3", "hydra.sweep.dir=search", "trainer.max_epochs=10"]
    job = submitted(slurm, command, small)
    until(lambda: [*desk.glob("search/*/checkpoints/last.ckpt")])
    said(slurm, "scancel", "--signal=TERM", f"{job}_1")
    again_at_once(slurm, f"{job}_1")
    until(lambda: not said(slurm, "squeue", "-h"))
    assert_none_lost_or_doubled(found := trials(desk / "search", postgres, "slurm"), 3)
    assert sorted(states(found))[:3] == ["COMPLETE"] * 3
    assert "repeat the command to continue the search" in "".join(f.read_text() for f in desk.glob("*.out"))


def test_trials_are_submitted_from_the_login_node(slurm, desk, postgres):
    pytest.importorskip("submitit", reason="the extra slurm is not installed")
    words = printed("python -m ahnn.train -m", postgres)
    small = [*SEARCH, "hydra.sweeper.study_name=login", "hydra.sweeper.n_trials=2", "hydra.sweep.dir=login"]
    said(slurm, *words, *small)
    assert states(trials(desk / "login", postgres, "login")) == ["COMPLETE"] * 2
    assert sorted(path.name for path in desk.iterdir()) == ["login", "search.sh", "train.sh"]
