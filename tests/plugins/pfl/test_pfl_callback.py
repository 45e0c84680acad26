"""The callback in a real, tiny Lightning run: with a trial, in a grid, and alone."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import lightning as L
import optuna
import pytest
import torch
from optuna.trial import TrialState, create_trial
from torch.utils.data import DataLoader, TensorDataset

from ahnn.errors import UserError
from ahnn_plugins.pfl import PFLCallback, PFLPruner, replay

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*LeafSpec.*:FutureWarning"),  # lightning 2.6.6 with torch 2.13
    pytest.mark.filterwarnings("ignore:.*does not have many workers.*"),  # a loader of one sample needs none
]

EPOCHS = 6
SHORT = {"fit_epochs": 4, "target_epoch": 6, "top_k": 2}


class Scripted(L.LightningModule):
    """Logs given validation losses, whatever it learns."""

    def __init__(self, losses: list[float]) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)
        self.losses = losses

    def training_step(self, batch, _):
        return self.layer(batch[0]).square().mean()

    def validation_step(self, _batch, _):
        self.log("val/loss", self.losses[self.current_epoch], batch_size=1)

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


def fit(callback: PFLCallback, losses: list[float]) -> L.Trainer:
    loader = DataLoader(TensorDataset(torch.ones(1, 1)), batch_size=1)
    trainer = L.Trainer(
        max_epochs=EPOCHS,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=1,
        callbacks=[callback],
    )
    trainer.fit(Scripted(losses), loader, loader)
    return trainer


def study_with(finals: list[float]) -> optuna.Study:
    study = optuna.create_study()
    for final in finals:
        study.add_trial(create_trial(value=final, intermediate_values={EPOCHS - 1: final}))
    return study


def test_a_hopeless_trial_is_pruned_and_the_log_replays(tmp_path: Path):
    study = study_with([0.1, 0.2])
    trial = study.ask()
    with pytest.raises(optuna.TrialPruned, match="forecast above threshold"):
        fit(PFLCallback(run_dir=str(tmp_path), trial=trial, **SHORT), [1.0] * EPOCHS)
    assert study.trials[-1].intermediate_values == dict.fromkeys(range(4), 1.0)
    entries = replay(tmp_path / "pfl.jsonl")
    assert [entry.logged.prune for entry in entries] == [False, False, False, True]
    assert all(entry.logged == entry.replayed for entry in entries)


def test_a_good_trial_runs_to_its_end_and_seeds_follow_each_other(tmp_path: Path):
    study = study_with([0.1, 0.2])
    trial = study.ask()
    for _ in (7, 201):
        fit(PFLCallback(run_dir=str(tmp_path), trial=trial, **SHORT), [0.5**epoch for epoch in range(EPOCHS)])
    assert sorted(study.trials[-1].intermediate_values) == list(range(2 * EPOCHS))
    entries = replay(tmp_path / "pfl.jsonl")
    assert len(entries) == 2 * EPOCHS
    assert all(entry.logged == entry.replayed for entry in entries)
    study.tell(trial, 0.03)
    assert study.trials[-1].state == TrialState.COMPLETE
    assert PFLPruner(EPOCHS).finals(study)[-1] == 0.5 ** (EPOCHS - 1)


def test_nan_prunes_at_once_and_is_strict_json(tmp_path: Path):
    with pytest.raises(optuna.TrialPruned, match="non-finite"):
        fit(
            PFLCallback(run_dir=str(tmp_path), trial=optuna.create_study().ask(), **SHORT),
            [float("nan")] * EPOCHS,
        )
    rows = [
        json.loads(line, parse_constant=pytest.fail)
        for line in (tmp_path / "pfl.jsonl").read_text().splitlines()
    ]
    assert rows[1]["loss"] == "nan"
    assert replay(tmp_path / "pfl.jsonl")[0].replayed.prune


def test_grid_jobs_share_a_record_and_stop_without_an_exception(tmp_path: Path):
    record = str(tmp_path / "pfl_record.jsonl")
    for run, scale in enumerate([0.1, 0.2, 5.0, 0.1]):
        callback = PFLCallback(run_dir=str(tmp_path / str(run)), record=record, group="spring/hnn", **SHORT)
        trainer = fit(callback, [scale] * EPOCHS)
        assert trainer.current_epoch == (4 if scale == 5.0 else EPOCHS)
    lines = (tmp_path / "pfl_record.jsonl").read_text().splitlines()
    assert [json.loads(line)["loss"] for line in lines] == pytest.approx([0.1, 0.2, 0.1])


def test_a_single_run_has_no_record_and_prunes_nothing(tmp_path: Path):
    callback = PFLCallback(run_dir=str(tmp_path), record=str(tmp_path / "absent" / "record.jsonl"), **SHORT)
    assert fit(callback, [9.0] * EPOCHS).current_epoch == EPOCHS
    assert not (tmp_path / "absent").exists()


def test_the_monitor_must_be_logged(tmp_path: Path):
    with pytest.raises(ValueError, match=r"expected the model to log 'val/mse'.*val/loss"):
        fit(PFLCallback(run_dir=str(tmp_path), monitor="val/mse", **SHORT), [1.0] * EPOCHS)


def test_losses_travel_with_the_checkpoint(tmp_path: Path):
    first, second = (PFLCallback(run_dir=str(tmp_path), **SHORT) for _ in range(2))
    fit(first, [1.0] * EPOCHS)
    second.load_state_dict(first.state_dict())
    assert second.state_dict() == {"losses": []}  # they count from the next fit on
    fit(second, [1.0] * EPOCHS)
    assert second.state_dict()["losses"] == [1.0] * (2 * EPOCHS)


def test_a_single_epoch_is_enough_and_none_is_refused(tmp_path: Path):
    callback, epochs = PFLCallback(run_dir=str(tmp_path), **SHORT), SimpleNamespace(is_global_zero=True)
    for wrong in (None, 0, -1):
        epochs.max_epochs = wrong
        with pytest.raises(UserError, match=f"expected trainer.max_epochs >= 1; received {wrong}"):
            callback.on_fit_start(epochs, None)  # pyright: ignore[reportArgumentType]
    epochs.max_epochs = 1
    callback.on_fit_start(epochs, None)  # pyright: ignore[reportArgumentType]


def test_a_run_without_a_trial_is_the_first_of_its_seeds(tmp_path: Path):
    fit(PFLCallback(run_dir=str(tmp_path), **SHORT), [0.5**epoch for epoch in range(EPOCHS)])
    rows = [json.loads(line) for line in (tmp_path / "pfl.jsonl").read_text().splitlines()[1:]]
    assert [(row["seed_index"], row["epoch"]) for row in rows] == [(0, epoch) for epoch in range(EPOCHS)]
