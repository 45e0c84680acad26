"""A training cut in its closing stage resumes there: weights and covariance of one never cut."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from entry import SMALL, Interrupted, call, untouched
from helpers import close
from safetensors.torch import load_file

from ahnn.checkpoints import read_checkpoint
from ahnn.cli.compose import compose_job
from ahnn.cli.training import train
from ahnn.training.closing_journal import ClosingJournal

NOISY = [
    *SMALL,
    "system.steps=40",
    "recipe=noisy_states",
    "data.noise=0.01",
    "data.correlation=estimate",
    "trainer.max_epochs=1",
    "loss.closing=1",
    "model.network.width=4",
    "evaluation.figures=false",
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uncut training: its folder, and the number of results in its journal."""
    place, counts = tmp_path_factory.mktemp("closing"), list[int]()
    with pytest.MonkeyPatch.context() as patch:
        remove = ClosingJournal.remove
        patch.setattr(ClosingJournal, "remove", lambda own: (counts.append(own.count), remove(own))[1])
        assert call("ahnn.train", *NOISY, f"run={place / 'whole'}") == 0
    assert not (place / "whole" / "checkpoints" / "closing").exists()
    return place / "whole", counts[0]


def trained(folder: Path, ckpt: str | None = None) -> None:
    job = compose_job(NOISY, folder)
    job.folder, job.ckpt = str(folder), ckpt
    with untouched():
        train(job)


def assert_same_end(one: Path, other: Path) -> None:
    contents = [read_checkpoint(folder / "checkpoints" / "best.ckpt") for folder in (one, other)]
    before, after = (content["ahnn"]["trained"] for content in contents)  # as the training left it
    assert before == after == {"loss": pytest.approx(before["loss"]), "epochs": 1}
    weights = [content["state_dict"] for content in contents]
    assert all(torch.equal(weights[0][key], value) for key, value in weights[1].items())
    factors = [load_file(folder / "covariance.safetensors")["factor"] for folder in (one, other)]
    whole, resumed = (factor @ factor.mT for factor in factors)
    close(resumed, whole, 1e-6)


def fail(*_, **__):
    raise Interrupted


def interrupted(folder: Path, ckpt: str | None, result) -> None:
    """Train with another `ClosingJournal.result`, and without an evaluation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ClosingJournal, "result", result)
        patch.setattr("ahnn.jobs.closing.report", fail)
        with pytest.raises(Interrupted):
            trained(folder, ckpt)


def cut_at(fraction: float, whole: tuple[Path, int], folder: Path) -> None:
    """Cut a training in its closing stage, resume it, cut its evaluation, and resume it again."""
    (uncut, count), result, computed = whole, ClosingJournal.result, list[str]()

    def cut(journal, name, compute):
        if journal.count >= fraction * count:
            raise Interrupted
        return result(journal, name, compute)

    def counted(journal, name, compute):
        return result(journal, name, lambda: (computed.append(name), compute())[1])

    interrupted(folder, None, cut)
    found = len(list((folder / "checkpoints" / "closing").glob("*.safetensors")))
    assert found >= fraction * count
    interrupted(folder, "last", counted)
    assert len(computed) == count - found
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ahnn.jobs.closing.conclude_with_noise", fail)  # it is done
        trained(folder, "last")
    assert_same_end(uncut, folder)


@pytest.mark.slow
def test_a_cut_closing_stage_goes_on_with_the_same_weights(whole, tmp_path):
    cut_at(0.5, whole, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.0, 0.2, 0.8, 0.95])
def test_wherever_it_is_cut(whole, tmp_path, fraction):
    cut_at(fraction, whole, tmp_path)
