"""Signals at random moments of a training: one message, an exit code, and a way to go on that keeps its word."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from .children import TRAINING, plain, same_weights, trained

NUMBERS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def cases(draw, folder):
    """Yield signals; one in six at the start of a process of its own, while it imports."""
    whole, started = folder / "whole", time.monotonic()
    assert trained(whole).code() == 0
    seconds = time.monotonic() - started
    while True:
        number, twice = draw.choice(NUMBERS), draw.random() < 0.2
        if draw.random() < 1 / 6:
            moment = draw.uniform(0.1, 4)
            yield f"{number.name} at {moment:.2f} s of a process", partial(at_start, folder, number, moment)
        else:
            moment = draw.uniform(0, seconds)
            yield (
                f"{number.name} at {moment:.2f} of {seconds:.2f} s{', twice' * twice}",
                partial(in_training, whole, number, moment, twice),
            )


def in_training(whole, number, moment, twice) -> None:
    """Send the signal and do what the message says."""
    run = Path(tempfile.mkdtemp(dir=whole.parent)) / "run"
    child = trained(run, cache=whole.parent / "cache")
    child.end(number, after=moment)
    if twice:
        child.end(number, after=0.01)
    code, said = child.code(), child.said()
    plain(said)
    if code == -number and not said:  # before it listens
        assert not run.exists()
        return
    assert code in (0, 128 + number), f"exit code {code}: {said[-300:]}"
    if code == 0:
        same_weights(whole, run)
        return
    assert "stopped by" in said, said[-300:]
    last = run / "checkpoints" / "last.ckpt"
    more = ["ckpt=last"] if last.exists() else []
    if "resume with" in said:
        assert last.exists(), "a resume point is promised and not there"
    elif "from the beginning" in said:
        assert not last.exists(), "there is a resume point of which nothing is said"
    child = trained(run, *more, cache=whole.parent / "cache", name="again")
    assert child.code() == 0, child.said()[-300:]
    same_weights(whole, run)
    shutil.rmtree(run.parent)


def at_start(folder, number, moment) -> None:
    """Send the signal to a process that may not yet have said that it listens."""
    place = Path(tempfile.mkdtemp(dir=folder))
    words = [sys.executable, "-m", "ahnn.train", *TRAINING, f"run={place / 'run'}"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    job = subprocess.Popen(
        words, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=place
    )
    time.sleep(moment)
    job.send_signal(number)
    said, _ = job.communicate(timeout=120)
    plain(said)
    assert job.returncode in (0, 128 + number, -number), f"exit code {job.returncode}: {said[-300:]}"
    shutil.rmtree(place)
