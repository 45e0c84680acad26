"""All rows of the paper's tables in one command: equal steps, kept runs, and no mixture of settings."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch
from entry import CutAfter, call

from ahnn.checkpoints import read_checkpoint
from ahnn.cli.reproduction_plan import plan
from ahnn.errors import UserError
from ahnn.files import claimed
from ahnn.jobs.fitting import fit

TINY = [
    "system=mass_spring",
    "budget=smoke",
    "seed=7",
    "experiment=paper_node,paper_ahnn5",
    "system.steps=60",
    "data.trajectories=20",
    "data.windows_per_epoch=160",
    "data.val_windows=40",
    "data.batch_size=16",
    "model.network.width=8",
    "plugins.ukf.cadence=20",
    "trainer.accelerator=cpu",
]
"""Two runs of 2 epochs of 10 steps."""


def reproduce(folder: Path, *overrides: str) -> int:
    return call("ahnn.reproduce", *TINY, *overrides, f"run={folder}")


def content(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Time and bytes of every file of the runs; the sweep's own record of its start is left out."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "multirun.yaml"]
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return read_checkpoint(folder / "checkpoints" / "best.ckpt")["state_dict"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A reproduction that nothing interrupted."""
    folder = tmp_path_factory.mktemp("reproduction") / "whole"
    assert reproduce(folder) == 0
    return folder


@pytest.fixture
def copied(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "copy")


def test_every_run_has_its_folder_equal_steps_and_the_paper_s_name(whole):
    found = {path.parent.name: json.loads(path.read_text()) for path in whole.glob("*/metrics.json")}
    assert found.keys() == {"NODE_7", "AHNN5_7"}
    assert [run["training"]["steps"] for run in found.values()] == [20, 20]
    for name, run in found.items():
        assert f"{run['model']}_{run['training']['seed']}" == name
        kinds = {(row["process"], row["estimator"], row["start"]) for row in run["rows"]}
        assert {("model", e, s) for e in (None, "ukf") for s in ("true", "perturbed")} <= kinds
        for part in ("config.yaml", "predictions.safetensors", "checkpoints/last.ckpt", "tensorboard"):
            assert (whole / name / part).exists()


def test_finished_runs_are_kept_and_an_evaluation_that_was_cut_is_made_again(copied, capsys, caplog):
    for name in ("metrics.json", "predictions.safetensors"):
        (copied / "AHNN5_7" / name).unlink()
    kept, trained = content(copied / "NODE_7"), weights(copied / "AHNN5_7")
    assert reproduce(copied, "threads=1") == 0
    assert content(copied / "NODE_7") == kept
    assert all(torch.equal(value, trained[key]) for key, value in weights(copied / "AHNN5_7").items())
    printed = capsys.readouterr()
    assert f"2 runs of 20 optimiser steps of 16 windows in {copied}, 1 of them finished" in caplog.text
    assert "NODE_7: finished" in printed.err
    table = printed.out[printed.out.rindex("true start   ") :]
    lines = [line.split()[0] for line in table.splitlines() if line.startswith("  ") and line[2] != " "]
    assert lines == ["NODE", "AHNN5", "floor"] * 2
    assert max(map(len, printed.out.splitlines()[:-1])) <= 80  # the last has the folder
    assert f"python -m ahnn.report {copied}" in table


@pytest.mark.slow
def test_a_training_that_was_cut_goes_on_to_the_same_bits(whole, tmp_path, monkeypatch, capsys):
    def cut(prepared):
        prepared.trainer.callbacks.append(CutAfter(13, ctrl_c=True))
        return fit(prepared)

    folder, alone = tmp_path / "cut", ["experiment=paper_ahnn5"]
    with monkeypatch.context() as patch:
        patch.setattr("ahnn.jobs.fitting.fit", cut)
        assert reproduce(folder, *alone) == 130
    assert capsys.readouterr().err.endswith("repeat the command to resume\n")
    assert read_checkpoint(folder / "AHNN5_7" / "checkpoints" / "last.ckpt")["global_step"] >= 10
    assert reproduce(folder, *alone) == 0
    assert "AHNN5_7: goes on" in capsys.readouterr().err
    expected = weights(whole / "AHNN5_7")
    assert all(torch.equal(value, expected[key]) for key, value in weights(folder / "AHNN5_7").items())


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        (["optimizer.lr=0.01"], "  optimizer.lr: expected 0.003, received 0.01"),
        (
            ["experiment=paper_hnn", "data.val_windows=30"],
            "  data.val_windows: expected 40, received 30",
        ),
        (["plugins=none"], "plugins.ukf"),
    ],
)
def test_other_settings_in_the_same_folder_are_refused(whole, changed, key, capsys):
    before = content(whole)
    overrides = [text for text in TINY if "ukf" not in text or "plugins=none" not in changed]
    assert call("ahnn.reproduce", *overrides, *changed, f"run={whole}") == 2
    error = capsys.readouterr().err.strip()
    assert f"run {whole}" in error
    assert key in error
    assert error.endswith("Choose another folder with run=")
    assert content(whole) == before


def test_a_run_of_another_process_is_left_to_it(copied, capsys):
    (copied / "NODE_7" / "metrics.json").unlink()
    with claimed(copied / "NODE_7", ".turn"):
        assert reproduce(copied) == 0
    printed = capsys.readouterr()
    assert "NODE_7: in use by another process" in printed.err
    assert "without results yet: NODE_7" in printed.out
    assert not (copied / "NODE_7" / "metrics.json").exists()


def test_all_models_take_equal_steps_on_all_windows_that_the_longest_has():
    made = plan(["system=molniya", "budget=paper", "seed=7", "experiment=paper_hnn,paper_ahnn5"])
    assert made.steps == 250 * -(-2000 * (1440 - 5 + 1) // 256)
    assert {cfg.data.windows_per_epoch for cfg in made.runs.values()} == {2000 * 1436}
    assert {cfg.model.network.width for cfg in made.runs.values()} == {256}


@pytest.mark.slow
def test_the_rows_are_those_of_the_paper():
    made = plan(["system=mass_spring", "budget=paper", "seed=7"])
    labels = ["MLP", "NODE", "HNN", "AHNN3", "AHNN5"]
    assert [*made.runs] == [f"{label}_7" for label in labels]
    first = [*made.runs.values()]
    assert [cfg.window for cfg in first] == [1, 1, 1, 3, 5]
    assert [cfg.optimizer.lr for cfg in first] == [1e-3, 1e-4, 1e-3, 1e-3, 1e-3]
    assert {(cfg.scheduler.upper_bound, cfg.trainer.max_epochs) for cfg in first} == {(350, 250)}
    assert all(cfg.plugins.ukf.tuning.trials == 200 for cfg in first)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], "system: expected one of mass_spring, molniya; received nothing"),
        (["system=kepler"], "system: expected one of mass_spring, molniya; received kepler"),
        (["system=molniya", "budget=tiny"], "budget: expected one of smoke, laptop, paper; received tiny"),
        (["system=molniya", "ckpt=last"], "ckpt: expected none"),
        (
            [*TINY, "data.windows_per_epoch=100000"],
            "expected equal numbers of steps for all models",
        ),
        ([*TINY, "optimizer.lrr=1"], "unknown key 'optimizer.lrr'"),
        ([*TINY, "experiment=paper_hmm"], "experiment: unknown option 'paper_hmm'"),
    ],
)
def test_a_command_that_makes_no_reproduction_is_refused(overrides, message):
    with pytest.raises(UserError) as error:
        plan(overrides)
    assert message in str(error.value)


@pytest.mark.slow
def test_runs_side_by_side_are_the_same(whole, tmp_path):
    folder = tmp_path / "parallel"
    assert reproduce(folder, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2") == 0
    for name in ("NODE_7", "AHNN5_7"):
        expected = weights(whole / name)
        assert all(torch.equal(value, expected[key]) for key, value in weights(folder / name).items())
