"""Two processes end with the weights of one, in one folder, and what cannot be divided is refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from entry import SMALL, call
from helpers import data_module

from ahnn.checkpoints import read_checkpoint
from ahnn.data.datamodule import WindowDataModule
from ahnn.data.loader import WindowLoader
from ahnn.systems import MassSpring

SPRING = MassSpring(name="mass_spring", dt=0.01, steps=1000)
# 155 windows in batches of 16 leave 11 for the last one, 6 and 5 for the two; 41 of validation leave 9.
UNEVEN = [*SMALL, "data.windows_per_epoch=155", "data.val_windows=41"]
UNEVEN += ["optimizer=adamw", "optimizer.lr=1e-2", "data.precision=64", "evaluation.figures=false"]
MODELS = ("mlp", "node", "hnn", "ahnn", "hnn_derivative")


def train(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    """Run the entry point as a user does."""
    place = "hydra.sweep.dir" if "-m" in overrides else "run"
    return subprocess.run(
        [sys.executable, "-m", "ahnn.train", *overrides, f"{place}={folder}"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def difference(a: Path, b: Path, name: str) -> float:
    """The largest difference of any weight, relative to the largest of its tensor."""
    one, other = (read_checkpoint(d / "checkpoints" / f"{name}.ckpt")["state_dict"] for d in (a, b))
    assert one.keys() == other.keys()
    size = {key: value.abs().max().clamp(min=1e-300) for key, value in other.items()}
    return max(float((one[key] - other[key]).abs().max() / size[key]) for key in one)


def assert_two_equal_one(folder: Path, *overrides: str) -> None:
    two, one = folder / "two", folder / "one"
    done = train(two, *UNEVEN, *overrides, "trainer=ddp", "trainer.accelerator=cpu")
    assert done.returncode == 0, done.stderr
    assert call("ahnn.train", *UNEVEN, *overrides, f"run={one}") == 0
    for name in ("last", "best"):
        assert difference(two, one, name) < 1e-6
    metrics = [json.loads((d / "metrics.json").read_text()) for d in (two, one)]
    assert metrics[0]["training"]["steps"] == metrics[1]["training"]["steps"] == 30
    assert metrics[0]["training"]["val_loss"] == pytest.approx(metrics[1]["training"]["val_loss"], rel=1e-6)
    files = [{str(f.relative_to(d)) for f in d.rglob("*")} for d in (two, one)]
    assert files[0] == files[1]
    assert {path.name for path in folder.iterdir()} == {"one", "two"}
    assert done.stdout.count("RMSE over unseen trajectories") == 1
    assert done.stderr.count("optimiser steps of 16 windows") == 1


@pytest.mark.slow
def test_two_processes_end_with_the_weights_of_one(tmp_path):
    assert_two_equal_one(tmp_path, "model=hnn", "loss.derivative=0.34")


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_every_model_ends_with_the_weights_of_one_process(model, tmp_path):
    derivative = [] if model == "hnn_derivative" else ["loss.derivative=0"]  # which is all that it has
    assert_two_equal_one(tmp_path, f"model={model}", *derivative)


@pytest.mark.slow
def test_a_study_of_trainings_on_two_devices(tmp_path):
    arguments = ["-m", *UNEVEN, "trainer=ddp", "trainer.accelerator=cpu", "hydra/sweeper=ahnn_optuna"]
    arguments += ["hydra/launcher=ahnn_process", "hydra.sweeper.n_trials=2", "model=hnn"]
    arguments += ["optimizer.lr=interval(1e-3,1e-2)"]
    done = train(tmp_path / "sweep", *arguments)
    assert done.returncode == 0, done.stderr
    assert "2 complete, 0 pruned, 0 failed" in done.stderr
    jobs = {path.name for path in (tmp_path / "sweep").iterdir() if path.is_dir()}
    assert jobs == {"0", "1", "experiment"}


def test_a_sweep_refuses_several_devices_in_its_own_process(tmp_path):
    arguments = ["-m", *UNEVEN, "trainer=ddp", "hydra/sweeper=ahnn_optuna", "model=hnn"]
    arguments += ["optimizer.lr=interval(1e-3,1e-2)"]
    done = train(tmp_path / "sweep", *arguments)
    assert done.returncode != 0
    assert "hydra/launcher=ahnn_process" in done.stderr
    assert not (tmp_path / "sweep" / "0").exists()


REFUSED = {
    "second-order steps": (["trainer=ddp", "optimizer=levenberg_marquardt"], "recipe=first_order"),
    "a job of a grid": (
        ["hydra.mode=MULTIRUN", "trainer=ddp", "optimizer=adamw"],
        "hydra/launcher=ahnn_process",
    ),
    "devices that are not there": (
        ["trainer.accelerator=cuda", "trainer.devices=99"],
        "trainer.accelerator: ",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_done_is_one_message(case, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    overrides, expected = REFUSED[case]
    assert call("ahnn.train", *SMALL, "trainer.accelerator=cpu", *overrides) == 2
    err = capfd.readouterr().err
    assert err.count("ahnn: ") == 1
    assert expected in err


def loaders(data: WindowDataModule, world: int) -> list[WindowLoader]:
    whole = data.train_dataloader()
    options = (whole.batch_size, whole.count, whole.seed, 0.0)
    return [WindowLoader(whole.windows, *options, rank=rank, world=world) for rank in range(world)]


@pytest.mark.parametrize("world", [1, 2, 3, 5])
def test_the_parts_of_a_batch_are_the_batch_and_their_mean_is_its_mean(world, cache):
    data = data_module(SPRING, cache, batch_size=7, windows_per_epoch=30)  # the last batch has 2 windows
    (whole,) = loaders(data, 1)
    for batch, *parts in zip(whole, *loaders(data, world), strict=True):
        assert batch.weight == 1
        kept = torch.cat([part.start for part in parts if part.weight])
        assert torch.equal(kept, batch.start)
        mean = sum(part.weight * part.increments.mean() for part in parts) / world
        assert float(mean) == pytest.approx(float(batch.increments.mean()), rel=1e-12)
