"""Signals to a training and to a search: one message, an exit code, and a way to go on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from entry import FIRST, forked, hear, started

from ahnn.checkpoints import read_checkpoint
from ahnn.cli import early_stops
from ahnn.cli.early_stops import ended
from ahnn.errors import Stopped


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.sampled(2)
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_scheduler_that_ends_a_training_loses_nothing(tmp_path, capfd, number, code):
    run = [*FIRST, "trainer.max_epochs=2000", "callbacks.last.every=100000", f"run={tmp_path / 'run'}"]
    job = forked("ahnn.train", *run, before=hear)
    last = tmp_path / "run" / "checkpoints" / "last.ckpt"
    while not last.exists():
        assert os.waitpid(job, os.WNOHANG) == (0, 0)
        time.sleep(0.05)
    os.kill(job, number)
    _, status = os.waitpid(job, 0)
    assert os.waitstatus_to_exitcode(status) == code
    said = "".join(capfd.readouterr())
    assert f"stopped by {number.name}; resume with the same command and run=" in said
    assert "Traceback" not in said
    assert read_checkpoint(last)["global_step"] > 0


TWICE = """
import signal
from ahnn.cli.guard import guard
from ahnn.cli.early_stops import ended

def told():
    signal.raise_signal(signal.SIGTERM)
    return "resume with ckpt=last"

def work():
    with ended(told):
        signal.raise_signal(signal.SIGTERM)

raise SystemExit(guard(work))
"""


def test_a_second_signal_does_not_take_the_place_of_the_message():
    job = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, check=False)
    assert (job.returncode, job.stderr) == (143, "ahnn: stopped by SIGTERM; resume with ckpt=last\n")


SWALLOWED = """
import contextlib
import signal
from ahnn.cli.guard import guard
from ahnn.errors import Stopped, UserError

def work():
    with contextlib.suppress(Stopped):
        signal.raise_signal(signal.SIGTERM)
    raise UserError("unknown key")

raise SystemExit(guard(work))
"""


def test_what_fails_after_a_signal_that_a_library_swallowed_is_the_stop():
    job = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, check=False)
    assert job.returncode == 143
    assert job.stderr.startswith("ahnn: stopped by SIGTERM; ")


def test_work_that_keeps_its_state_does_not_begin_after_a_signal_that_a_library_swallowed(monkeypatch):
    monkeypatch.setattr(early_stops, "_arrived", [signal.SIGINT])
    with (
        pytest.raises(Stopped, match=r"^stopped by Ctrl-C; go on so$"),
        ended(lambda: "go on so"),
    ):
        pytest.fail("it began")


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0.02, 0.1, 0.3, 1.0, 2.0])
def test_ctrl_c_is_no_traceback_however_early(tmp_path, moment):
    job = started(tmp_path, *FIRST, "trainer.max_epochs=2000")
    time.sleep(moment)
    job.send_signal(signal.SIGINT)
    said, _ = job.communicate(timeout=60)
    # Until then it is Python that starts, and the first lines of the package, which let signals end it.
    begun = "train.py" in said
    assert "Traceback" not in said or not begun
    starting = job.returncode == 1 and "KeyboardInterrupt" in said and not begun
    assert starting or job.returncode in (130, -signal.SIGINT)


@pytest.mark.slow
def test_ctrl_c_in_a_search_says_that_the_search_goes_on(tmp_path):
    short = ["system.steps=60", "data.trajectories=20", "hydra/launcher=ahnn_process"]
    search = ["-m", "sweep=quick", *short, f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    job = started(tmp_path, *search)
    while not (tmp_path / "sweep" / "0" / "console.log").exists():
        assert job.poll() is None
        time.sleep(0.05)
    job.send_signal(signal.SIGINT)
    said, _ = job.communicate(timeout=60)
    assert job.returncode == 130
    assert "ahnn: stopped by Ctrl-C; repeat the command to continue the search\n" in said
    assert "from the beginning" not in said


@pytest.mark.slow
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
