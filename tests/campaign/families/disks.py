"""Disks that are full, limited, read-only, failing or gone: one message, and what was good stays good."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from ahnn.checkpoints import read_checkpoint

from .children import TRAINING, Child, command, plain, trained

ERRORS = [errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EMFILE, errno.ENOENT]
CALLS = ["fsync", "replace", "open", "mkdir"]


def cases(draw, folder):
    """Yield disks with a fault at a random moment."""
    kinds = ["failing call", "failing call", "file size", "deleted"]
    mounts = subprocess.run(["mount", "--version"], capture_output=True, check=False).returncode == 0
    kinds += ["small", "small", "read-only"] if mounts and os.geteuid() == 0 else []
    while True:
        kind = draw.choice(kinds)
        place = Path(tempfile.mkdtemp(dir=folder))
        if kind == "failing call":
            name, number, at = draw.choice(CALLS), draw.choice(ERRORS), draw.randint(1, 12)
            yield f"{os.strerror(number)} at {name} {at}", partial(failing, place, name, number, at)
        elif kind == "file size":
            size = draw.choice([0, 100, 3_000, 30_000, 60_000])
            yield f"files of {size} bytes at most", partial(limited, place, size)
        elif kind == "deleted":
            moment = draw.uniform(0, 2)
            yield f"deleted after {moment:.2f} s", partial(deleted, place, moment)
        else:
            size = "4k,ro" if kind == "read-only" else f"{draw.choice([8, 40, 80, 120, 200, 400])}k"
            yield f"a disk of {size}", partial(small, place, size, draw.random() < 0.3)


def judged(child: Child, run: Path, codes=(0, 2)) -> None:
    """Assert a good end, and whole checkpoints."""
    code, said = child.code(), child.said()
    plain(said)
    assert code in codes, f"exit code {code}: {said[-300:]}"
    for path in run.glob("checkpoints/*.ckpt"):
        read_checkpoint(path)


def failing(place, name, number, at) -> None:
    """One call of the operating system fails; then the same training goes on."""
    run = place / "run"
    os.environ["AHNN_CACHE"] = str(place / "cache")

    def work() -> None:
        real, calls = getattr(os, name), iter(range(1, 10**9))

        def odd(*args, **kwargs):
            ours = name == "fsync" or str(place) in str(args[0])
            if ours and next(calls) == at:
                raise OSError(number, os.strerror(number), str(args[0]) if name != "fsync" else None)
            return real(*args, **kwargs)

        setattr(os, name, odd)
        command("ahnn.train", *TRAINING, f"run={run}")()

    judged(Child(work, place / "log"), run)
    goes_on(run, place)


def goes_on(run, place) -> None:
    """Assert that the training can be finished where the fault is gone."""
    more = ["ckpt=last"] if (run / "checkpoints" / "last.ckpt").exists() else []
    child = trained(run, *more, cache=place / "cache", name="again")
    assert child.code() == 0, child.said()[-300:]
    shutil.rmtree(place)


def limited(place, size) -> None:
    """No file may be larger."""

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        command("ahnn.train", *TRAINING, f"run={place / 'run'}")()

    os.environ["AHNN_CACHE"] = str(place / "cache")
    log = place / "log"
    child = Child(lambda: os._exit(_apart(work, log)), place / "outer")
    code = child.code()
    said = log.read_text(errors="replace") if log.exists() else ""
    plain(said)
    assert code in (0, 2), f"exit code {code}: {said[-300:]}"
    for path in (place / "run").glob("checkpoints/*.ckpt"):
        read_checkpoint(path)
    goes_on(place / "run", place)


def _apart(work, log) -> int:
    """Do the work in a child whose output goes through a pipe, which no limit on files touches."""
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        os.close(read)
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(write, number)
            setattr(sys, name, os.fdopen(number, "w", buffering=1, closefd=False))
        try:
            work()
            code = 0
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
        except BaseException:
            import traceback

            os.write(2, traceback.format_exc().encode())
            code = 1
        os._exit(code)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        log.write_bytes(pipe.read())
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def deleted(place, moment) -> None:
    """Somebody removes the folder of the run."""
    run = place / "run"
    child = trained(run)
    try:
        for _ in range(max(1, round(moment / 0.1))):
            os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            __import__("time").sleep(0.1)
        shutil.rmtree(run, ignore_errors=True)
    finally:
        judged(child, run)
    shutil.rmtree(place)


def small(place, size, with_cache) -> None:
    """A disk of a few kilobytes, or one that cannot be written."""
    disk = place / "disk"
    disk.mkdir()
    options = f"size={size}"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(disk)], check=True)
    try:
        cache = disk / "cache" if with_cache else place / "cache"
        judged(trained_at(place, disk / "run", cache), disk / "run")
        assert not [*disk.rglob("*.tmp")], "leftovers"
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)
    shutil.rmtree(place)


def trained_at(place, run, cache) -> Child:
    """Start a training whose output is kept on another disk than its folder."""
    os.environ["AHNN_CACHE"] = str(cache)
    return Child(command("ahnn.train", *TRAINING, f"run={run}"), place / "log")
