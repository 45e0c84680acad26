"""Kills at random moments: of writers of checkpoints, caches and results, and of trainings that go on."""

from __future__ import annotations

import functools
import itertools
import os
import shutil
import tempfile
import time
from functools import partial
from pathlib import Path

import torch

from ahnn.checkpoints import read_checkpoint
from ahnn.data import store
from ahnn.data.generate import generate
from ahnn.files import write_atomically, write_cached
from ahnn.systems import MassSpring
from ahnn.training.checkpoint_io import AtomicCheckpointIO

from .children import Child, same_weights, trained

SPRING = MassSpring(name="spring", dt=0.01, steps=2000)


def cases(draw, folder):
    """Yield kills of writers, on the disk and on a tmpfs, and of trainings."""
    whole, seconds = None, 0.0
    while True:
        kind = draw.choice(["training", *6 * ["checkpoint"], *3 * ["cache"], *2 * ["result"]])
        if kind != "training":
            place = draw.choice([str(folder), "/dev/shm"])
            yield f"{kind} in {place}", partial(WRITERS[kind], Path(place), draw.random())
            continue
        if whole is None:
            whole, started = folder / "whole", time.monotonic()
            assert trained(whole).code() == 0
            seconds = time.monotonic() - started
        moments = [draw.uniform(0, seconds) for _ in range(draw.randint(1, 4))]
        yield f"training at {moments}", partial(training, whole, moments)


def training(whole, moments) -> None:
    """Kill a training again and again; in the end it has the bits of one that was never killed."""
    run = Path(tempfile.mkdtemp(dir=whole.parent)) / "run"
    for moment in moments:
        child = trained(run, *again(run), cache=whole.parent / "cache")
        child.end(after=moment)
        child.code()
    child = trained(run, *again(run), cache=whole.parent / "cache")
    assert child.code() == 0, child.said()[-400:]
    same_weights(whole, run)
    assert not [*run.rglob("*.tmp")], "leftovers"
    shutil.rmtree(run.parent)


def again(run) -> list[str]:
    """Return what resumes a run where it can be."""
    return ["ckpt=last"] if (run / "checkpoints" / "last.ckpt").exists() else []


def killed(place, moment, work) -> tuple[Path, int]:
    """Kill a writer that repeats its work, after it has written once; return its folder and the last number."""
    folder = Path(tempfile.mkdtemp(prefix="ahnn_campaign_", dir=place))
    written = folder.parent / f"{folder.name}.written"

    def loop() -> None:
        for number in itertools.count(1):
            work(folder, number)
            with open(written, "ab") as file:
                file.write(b".")

    child = Child(loop, folder.parent / f"{folder.name}.log")
    until = time.monotonic() + 120
    while not written.exists():
        time.sleep(0.001)
        assert time.monotonic() < until, f"nothing written in 120 s: {child.said()[-200:]!r}"
        assert os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None, child.said()
    child.end(after=0.03 * moment)
    child.code()
    count = written.stat().st_size
    written.unlink()
    child.log.unlink()
    return folder, count


def checkpoint(place, moment) -> None:
    """The checkpoint is the last that was written, or the one after it."""

    def write(folder, number) -> None:
        w = torch.full((100_000,), float(number))
        AtomicCheckpointIO().save_checkpoint(
            {"state_dict": {"w": w}, "ahnn": {}, "n": number}, folder / "last.ckpt"
        )

    folder, count = killed(place, moment, write)
    found = read_checkpoint(folder / "last.ckpt")
    assert found["n"] in (count, count + 1), f"{found['n']} after {count}"
    assert bool((found["state_dict"]["w"] == found["n"]).all()), "torn"
    write(folder, 0)
    assert {path.name for path in folder.iterdir()} == {"last.ckpt", ".ahnn-files"}, "leftovers"
    shutil.rmtree(folder)


@functools.cache
def made():
    """Return the data of the spring, which no case changes."""
    return generate(SPRING, 4, 0)


def cache(place, moment) -> None:
    """The data are those that were generated."""
    recipe, truth = store.recipe(SPRING, 4, 0), made()

    def write(folder, number) -> None:
        del number
        store.load_or_make(folder, recipe, lambda: [truth])
        (path,) = folder.glob("*.safetensors")
        path.unlink()

    folder, _ = killed(place, moment, write)
    again = store.load_or_make(folder, recipe, lambda: [truth])
    assert torch.equal(again.states, truth.states), "other states"
    write_cached(folder / "another", b"")
    assert not [*folder.glob(".*.tmp")], "leftovers"
    shutil.rmtree(folder)


def result(place, moment) -> None:
    """The file is whole."""

    def write(folder, number) -> None:
        write_atomically(folder / "metrics.json", (f"{number:09d}" * 50_000).encode())

    folder, count = killed(place, moment, write)
    content = (folder / "metrics.json").read_text()
    assert content == content[:9] * 50_000, "torn"
    assert int(content[:9]) in (count, count + 1), "lost"
    write(folder, 0)
    assert {path.name for path in folder.iterdir()} == {"metrics.json", ".ahnn-files"}, "leftovers"
    shutil.rmtree(folder)


WRITERS = {"checkpoint": checkpoint, "cache": cache, "result": result}
