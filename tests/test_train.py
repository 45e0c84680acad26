"""The entry points: a run leaves everything behind that it should, and a mistake leaves nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from entry import SMALL, call
from hydra.core.global_hydra import GlobalHydra
from safetensors.torch import load_file

from ahnn.checkpoints import read_checkpoint
from ahnn.evaluation import Who, load_results
from ahnn.evaluation.sinks.figure_files import FORMATS

SPRING = [
    "recipe=first_order",
    "budget=smoke",
    "system.steps=240",
    "trainer.accelerator=cpu",
    "model.network.width=8",
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished smoke run on the spring, whose figures are pictures alone."""
    folder = tmp_path_factory.mktemp("runs") / "spring"
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(FORMATS, ".svg")
        assert call("ahnn.train", *SPRING, f"run={folder}") == 0
    return folder


def test_a_run_leaves_config_weights_scores_predictions_and_figures(run):
    files = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    expected = {"config.yaml", "metrics.json", "predictions.safetensors"}
    expected |= {"checkpoints/best.ckpt", "checkpoints/last.ckpt"}
    expected |= {f"figures/{name}.png" for name in ("phase_portrait", "energy", "error")}
    assert expected <= files
    assert any("tfevents" in name for name in files)
    assert not [name for name in files if "/." in name and not name.endswith("/.ahnn-files")]


def test_metrics_have_models_and_floors_from_both_starts(run):
    results = load_results(run)
    identities = [row.who for row in results.rows]
    assert identities[:2] == [Who("model", "true"), Who("model", "perturbed")]
    assert identities[2:4] == [
        Who("exact field, rk4", "true", floor=True),
        Who("exact flow", "perturbed", floor=True),
    ]
    assert all(who.estimator == "ukf" for who in identities[4:])
    assert len(identities) == len(set(identities)) == 12
    training = results.training
    assert (training["steps"], training["seed"], training["window"]) == (50, 7, 5)
    assert results.assumes == "generic Hamiltonian, cartesian inputs"
    assert results.space.units.position == "m"
    assert 0 < results.rows[2].scores.position < 1e-6  # rk4 with 0.01 s on the spring
    assert results.rows[3].scores.position == pytest.approx(3e-4, rel=0.9)
    for key in ("ahnn", "command", "date", "host", "threads", "torch", "lightning"):
        assert results.about[key]


def test_predictions_are_those_that_were_scored(run):
    metrics = json.loads((run / "metrics.json").read_text())
    arrays = load_file(run / "predictions.safetensors")
    error = (arrays["true_start"] - arrays["truth"])[..., 0]
    assert arrays["truth"].dtype == torch.float64
    position = float(error.square().mean(1).sqrt().mean())
    assert metrics["rows"][0]["position"] == pytest.approx(position, rel=1e-12)


@pytest.mark.slow
def test_the_table_shows_units_and_the_floor_in_80_columns(run, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert call("ahnn.evaluate", f"run={run}", "name=table") == 0
    out = capsys.readouterr().out
    for text in ("[m]", "[m/s]", "[J]", "exact field, rk4", "exact flow", "perturbed start", "floor"):
        assert text in out
    assert max(map(len, out.splitlines())) <= 80


def short(tmp_path, *overrides):
    return [*SMALL, f"run={tmp_path / 'run'}", *overrides]


MISTAKES = {
    "unknown key": (["modle=ahnn"], ["modle", "model"]),
    "unknown nested key": (["optimizer.lrr=1"], ["optimizer.lrr"]),
    "unknown option of a group": (["system=molnya"], ["molnya", "molniya"]),
    "unknown key of a built object": (["+data.widow=3"], ["widow", "window"]),
    "wrong type": (["data.batch_size=many"], ["data.batch_size", "int", "'many'"]),
    "wrong type of a network": (["model.network.width=2.5"], ["width", "2.5"]),
    "wrong seed": (["seed=x"], ["seed", "'x'"]),
    "negative seed": (["seed=-1"], ["-1"]),
    "unknown choice": (["model.hamiltonian=genric"], ["genric", "generic"]),
    "unknown integrator": (["integrator.name=rk5"], ["rk5", "rk4"]),
    "window too long": (["window=61"], ["windows of 1 to 60 steps", "received window=61"]),
    "no window": (["window=0"], ["window: expected int >= 1; received 0"]),
    "empty split": (["data.trajectories=2"], ["train, val, test; received 2 trajectories"]),
    "reversed range": (["system.q0=[1.0,-1.0]"], ["q0", "[1.0, -1.0]"]),
    "rate below its infimum": (
        ["optimizer=adamw", "scheduler=exp_hyperbolic", "optimizer.lr=1e-9"],
        ["1e-09"],
    ),
    "missing checkpoint": (["ckpt=last"], ["last.ckpt", "none"]),
    "composition of a field that is not separable": (
        ["integrator=leapfrog"],
        ["leapfrog", "GenericHamiltonian"],
    ),
    "syntax": (["model=[ahnn"], ["[ahnn"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.sampled(2)
def test_a_mistake_is_one_message_and_leaves_nothing(mistake, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    overrides, expected = MISTAKES[mistake]
    assert call("ahnn.train", *short(tmp_path, *overrides)) == 2
    out, err = capfd.readouterr()
    assert err.startswith("ahnn: ")  # and nothing of Hydra's before it
    assert err.count("ahnn: ") == 1
    for text in expected:
        assert text in err
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []
    assert not GlobalHydra.instance().is_initialized()


def test_a_folder_that_cannot_be_written_is_one_message(tmp_path, capfd):
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "sub"
    assert call("ahnn.train", *SMALL, f"run={folder}") == 2
    err = capfd.readouterr().err
    assert str(folder) in err or str(tmp_path / "file") in err
    assert "Traceback" not in err


def test_a_cache_that_cannot_be_written_is_one_message(tmp_path, capfd):
    (tmp_path / "file").write_text("")
    assert call("ahnn.train", *short(tmp_path, f"data.cache={tmp_path}/file/sub")) == 2
    err = capfd.readouterr().err
    assert "file/sub" in err
    assert "Traceback" not in err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


CHECKPOINTS = {
    "architecture": (["model.network.depth=3"], ["model.network.depth", "expected 2", "received 3"]),
    "model": (["model=node"], ["model.hamiltonian"]),
    "system": (["system.stiffness=7.0"], ["parameters.stiffness", "expected 5.0", "received 7.0"]),
}


@pytest.mark.parametrize("what", CHECKPOINTS)
def test_a_checkpoint_of_another_training_is_refused_with_every_difference(run, tmp_path, capfd, what):
    overrides, expected = CHECKPOINTS[what]
    path = run / "checkpoints" / "best.ckpt"
    arguments = [*SPRING, f"run={tmp_path / 'run'}", f"ckpt={path}", *overrides]
    assert call("ahnn.train", *arguments) == 2
    err = capfd.readouterr().err
    for text in (*expected, str(path)):
        assert text in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_checkpoint_is_one_message(run, tmp_path, capfd):
    path = tmp_path / "half.ckpt"
    content = (run / "checkpoints" / "best.ckpt").read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert call("ahnn.train", *short(tmp_path, f"ckpt={path}")) == 2
    err = capfd.readouterr().err
    assert "half.ckpt: expected an intact ahnn checkpoint" in err
    assert "Traceback" not in err
    assert [p.name for p in tmp_path.iterdir()] == ["half.ckpt"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "usage"),
        (["run=nowhere"], "nowhere"),
        (["run={run}", "modle=3"], "modle"),
        (["run={run}", "plugins=ufk"], "ufk"),
        (["run={run}", "threads=many"], "many"),
    ],
)
def test_mistakes_in_an_evaluation_are_one_message(run, capfd, arguments, expected):
    before = (run / "metrics.json").read_bytes()
    assert call("ahnn.evaluate", *(a.format(run=run) for a in arguments)) == 2
    err = capfd.readouterr().err
    assert expected in err
    assert "Traceback" not in err
    assert (run / "metrics.json").read_bytes() == before


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_best_weights(tmp_path, capfd):
    spoil = ["+callbacks.spoil._target_=entry.SpoilAfter", "+callbacks.spoil.steps=14"]
    assert call("ahnn.train", *short(tmp_path, *spoil)) == 3
    err = capfd.readouterr().err
    assert "epoch 1, batch 4" in err
    assert "Traceback" not in err
    best = read_checkpoint(tmp_path / "run" / "checkpoints" / "best.ckpt")
    assert all(bool(tensor.isfinite().all()) for tensor in best["state_dict"].values())
    last = read_checkpoint(tmp_path / "run" / "checkpoints" / "last.ckpt")
    assert all(bool(tensor.isfinite().all()) for tensor in last["state_dict"].values())
    assert not (tmp_path / "run" / "metrics.json").exists()


def test_a_multirun_makes_four_folders_and_one_table(tmp_path, capfd):
    jobs = ["-m", "model=hnn,ahnn", "seed=7,201", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    jobs += ["evaluation=scores", "recipe=first_order"]
    assert call("ahnn.train", *jobs, *SMALL) == 0
    folders = sorted(path.name for path in (tmp_path / "sweep").iterdir() if path.is_dir())
    assert folders == ["0", "1", "2", "3"]
    settings = set()
    for folder in folders:
        metrics = json.loads((tmp_path / "sweep" / folder / "metrics.json").read_text())
        settings.add((metrics["model"], metrics["training"]["seed"]))
    assert settings == {("hnn", 7), ("hnn", 201), ("ahnn5", 7), ("ahnn5", 201)}
    out = capfd.readouterr().out
    table = out[out.index("sweep") :]
    assert table.count("model=") == 4
    assert "no scores" not in table
    before = (tmp_path / "sweep" / "multirun.yaml").read_bytes()
    assert call("ahnn.train", "-m", "model=hnn", *jobs[2:], *SMALL) == 2
    assert "expected a folder without checkpoints" in capfd.readouterr().err
    assert (tmp_path / "sweep" / "multirun.yaml").read_bytes() == before


def test_help_and_a_mistake_work_from_any_directory(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", "--help") == 0
    helped = capfd.readouterr().out
    for group in ("system", "model", "integrator", "optimizer", "budget"):
        assert group in helped
    assert call("ahnn.train", "seed=x") == 2
    assert "ahnn: seed: expected int from 0 to 4294967295; received 'x'" in capfd.readouterr().err
    assert list(Path(tmp_path).rglob("config.yaml")) == []


def test_a_training_that_diverged_says_so_and_keeps_what_there_is(tmp_path, capfd):
    asked = ["recipe=first_order", "model=mlp", "optimizer.lr=100", "trainer.max_epochs=1", *SMALL[:6]]
    folder = tmp_path / "run"
    assert call("ahnn.train", *asked, "plugins=none", "trainer.accelerator=cpu", f"run={folder}") == 3
    out, err = capfd.readouterr()
    assert "diverged: 1 of 1 predictions run to infinity" in out
    last = err.splitlines()[-1]
    assert last.startswith("ahnn: training diverged: all predictions of unseen trajectories run")
    assert str(folder) in last
    assert load_results(folder).rows[0].scores.position == float("inf")
    assert float(load_file(folder / "predictions.safetensors")["true_start"].abs().max()) > 1e150
    assert (folder / "figures" / "error.png").exists()
    assert call("ahnn.report", str(folder), f"output={tmp_path / 'report'}", "report.figures=false") == 0
    assert "diverged" in (tmp_path / "report" / "report.html").read_text()
