"""A training that is cut in mid-epoch and resumed ends with the same bits as one that was never cut."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
import torch
from entry import SMALL, Interrupted, call, forked, untouched
from omegaconf import DictConfig

from ahnn.checkpoints import read_checkpoint
from ahnn.cli.compose import compose_job
from ahnn.cli.training import train

CASES = {
    "mlp": ["model=mlp"],
    "node": ["model=node"],
    "hnn": ["model=hnn"],
    "ahnn": ["model=ahnn"],
    "hnn_derivative": ["model=hnn_derivative"],
    "derivative_then_recursive": ["model=ahnn", "loss.derivative=0.5"],
    "measurements": [
        "recipe=measurements",
        "data.noise=0.01",
        "data.gaps=0.1",
        "loss.stages=[[weak,0.4],[4,1.0]]",
        "data.every=3",
    ],
    "levenberg_marquardt": ["model=hnn", "optimizer=levenberg_marquardt", "data.precision=64"],
}
# Ten steps an epoch, a checkpoint every four (or ten) steps and at the end of each epoch.
EVERY = {"in mid-epoch": 4, "at the first batch of an epoch": 4, "after the last batch of an epoch": 10}
CUTS = {
    "in mid-epoch": {"steps": 15},
    "at the first batch of an epoch": {"steps": 11},
    "after the last batch of an epoch": {"steps": 20, "validation": True},
}

RESUMES_FROM = {
    "in mid-epoch": 12,
    "at the first batch of an epoch": 10,
    "after the last batch of an epoch": 10,  # its validation is still to come
}


@pytest.fixture(scope="module", autouse=True)
def no_evaluation():
    """Training alone is compared; the evaluation after it has tests of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ahnn.jobs.closing.judge", lambda *_, **__: 0.0)
        yield


def weights(folder: Path, name: str):
    return read_checkpoint(folder / "checkpoints" / f"{name}.ckpt")["state_dict"]


def seconds(folder: Path) -> float:
    """The duration of the training up to the last checkpoint."""
    return read_checkpoint(folder / "checkpoints" / "last.ckpt")["callbacks"]["TrainingTime"]["seconds"]


def assert_same_bits(a: Path, b: Path, names: tuple[str, ...] = ("last", "best")) -> None:
    for name in names:
        one, other = weights(a, name), weights(b, name)
        assert one.keys() == other.keys()
        different = [key for key in one if not torch.equal(one[key], other[key])]
        assert not different, f"{name}: {different}"


def trained(cfg: DictConfig, folder: Path, **changes: object) -> None:
    """Train a composed job in a folder, with some keys changed."""
    job = cfg.copy()
    job.folder = str(folder)
    for key, value in changes.items():
        job[key] = value
    with untouched():
        train(job)


@pytest.fixture(scope="module", params=CASES)
def uninterrupted(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param) / "whole"
    cfg = compose_job([*CASES[request.param], *SMALL], folder)
    trained(cfg, folder)
    assert read_checkpoint(folder / "checkpoints" / "last.ckpt")["global_step"] == 30
    return cfg, folder


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.sampled(3)
def test_a_cut_training_ends_with_the_same_bits(uninterrupted, tmp_path, cut):
    cfg, whole = uninterrupted
    folder = tmp_path / "cut"
    often = cfg.copy()
    often.callbacks.last.every = EVERY[cut]
    callbacks = {**often.callbacks, "cut": {"_target_": "entry.CutAfter", **CUTS[cut]}}
    with pytest.raises(Interrupted):
        trained(often, folder, callbacks=callbacks)
    assert read_checkpoint(folder / "checkpoints" / "last.ckpt")["global_step"] == RESUMES_FROM[cut]
    before = seconds(folder)
    trained(often, folder, ckpt="last")
    assert_same_bits(whole, folder)
    assert seconds(folder) > before > 0.0


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_killed_training_ends_with_the_same_bits(tmp_path):
    overrides = [*CASES["ahnn"], *SMALL, "callbacks.last.every=4"]
    kill = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.steps=17", "+callbacks.cut.kill=true"]
    _, status = os.waitpid(forked("ahnn.train", *overrides, *kill, f"run={tmp_path / 'cut'}"), 0)
    assert os.WIFSIGNALED(status)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert call("ahnn.train", *overrides, f"run={tmp_path / 'cut'}", "ckpt=last") == 0
    assert call("ahnn.train", *overrides, f"run={tmp_path / 'whole'}") == 0
    assert_same_bits(tmp_path / "whole", tmp_path / "cut")


def test_another_seed_gives_other_weights(tmp_path):
    for seed in (7, 201):
        assert call("ahnn.train", *SMALL, f"run={tmp_path / str(seed)}", f"seed={seed}") == 0
    with pytest.raises(AssertionError, match="network"):
        assert_same_bits(tmp_path / "7", tmp_path / "201")
