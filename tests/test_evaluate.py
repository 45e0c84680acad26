"""Evaluating a finished run: what may be changed and how, and mistakes that leave every file as it was."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import torch
import yaml
from entry import call

from ahnn.checkpoints import read_checkpoint
from ahnn.errors import UserError
from ahnn.evaluation import Who, load_results
from ahnn.pretrained import HERE, names

EVALUATE = "ahnn.evaluate"
REMOVED = object()


@pytest.fixture
def run(finished, tmp_path):
    """A copy that a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def again(run, *arguments, name="again"):
    """The results of another evaluation of a run."""
    assert call(EVALUATE, f"run={run}", f"name={name}", *arguments) == 0
    return load_results(run / "evaluations" / name)


def store(run, **changes):
    """Change entries of the configuration of a run."""
    cfg = yaml.safe_load((run / "config.yaml").read_text())
    cfg = {key: value for key, value in (cfg | changes).items() if value is not REMOVED}
    (run / "config.yaml").write_text(yaml.safe_dump(cfg))


def refused(folder, capfd, *arguments):
    """The message of an evaluation that must be refused and leave every file as it was."""
    before = files(folder)
    capfd.readouterr()
    assert call(EVALUATE, *arguments) == 2
    err = capfd.readouterr().err
    assert "Traceback" not in err
    assert err.count("\n") == 1
    assert files(folder) == before
    return err


MADE = "expected a key that applies to a finished run, not to its training; "


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("model.network.width=12", rf"model\.network\.width: {MADE}"),
        ("model=mlp", rf"model: {MADE}"),
        ("integrator.name=rk4", rf"integrator\.name: {MADE}"),
        ("loss.delta=2", rf"loss\.delta: {MADE}"),
        ("window=3", rf"window: {MADE}"),
        ("seed=3", rf"seed: {MADE}"),
        ("data.batch_size=3", rf"data\.batch_size: {MADE}"),
        ("system=molniya", rf"system: {MADE}"),
        ("data=null", rf"data: {MADE}"),
        ("label=[a", r"'label=\[a': special characters in a value need quotes"),
        ("seed=1,2", r"'seed=1,2': expected key=value with one value"),
        ("~plugins", "usage"),
        ("+label=a", r"'\+label=a': expected key=value with one value"),
        ("measurement=null", r"measurement: expected one of .*; received 'measurement=null'"),
        ("plugins=3", r"plugins: expected one of .*none.*planets.*; received 'plugins=3'"),
        ("plugins=ufk", r"ufk"),
        ("system.stifness=9", r"system\.stifness: expected .*; did you mean 'system\.stiffness'"),
        ("system.stiffness=nan", r"system\.stiffness: expected float > 0; received nan"),
        (
            "data.split=[0.2,0.2,0.6]",
            r"test trajectories not used in training.*11 of 12 were used",
        ),
        ("ckpt=first.ckpt", r"first\.ckpt: expected best, last or a file; received none"),
        ("name=a/b", r"evaluation name: expected at most.*received 'a/b'"),
        ("threads=many", r"threads.*'many'"),
    ],
)
def test_an_override_that_has_no_effect_is_one_message(run, capfd, override, expected):
    assert re.search(expected, refused(run, capfd, f"run={run}", override))


@pytest.mark.parametrize(
    ("file", "content", "expected"),
    [
        (
            "config.yaml",
            "seed: [1\nlabel: }",
            "received a damaged file: while parsing",
        ),
        (
            "config.yaml",
            "- seed\n- label",
            r"config\.yaml: .*, with plain values for each key; received",
        ),
        (
            "config.yaml",
            "",
            r"config\.yaml: .*, with plain values for each key; received None",
        ),
        (
            "config.yaml",
            "a: &a [1]\nb: *a",
            "received a damaged file: an alias",
        ),
        ("config.yaml", "hello: 1", r"expected the configuration of a run; received one without system"),
        ("metrics.json", '{"schema": 2', r"metrics\.json: expected the results of an evaluation; received"),
        ("metrics.json", '{"rows": []}', r"metrics\.json: expected schema 2; received none"),
    ],
)
def test_a_damaged_file_of_a_run_is_one_message(run, capfd, file, content, expected):
    (run / file).write_text(content)
    assert re.search(expected, refused(run, capfd, f"run={run}"))


@pytest.mark.parametrize("key", ["system", "label", "evaluation"])
def test_a_configuration_without_a_part_is_named(run, capfd, key):
    store(run, **{key: REMOVED})
    assert f"expected the configuration of a run; received one without {key}" in refused(
        run, capfd, f"run={run}"
    )


def test_a_flipped_bit_in_the_weights_is_one_message(run, capfd):
    path = run / "checkpoints" / "best.ckpt"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert "best.ckpt: expected an intact ahnn checkpoint" in refused(run, capfd, f"run={run}")


def test_help_says_how_to_use_it(capsys):
    assert call(EVALUATE, "--help") == 0
    out = capsys.readouterr().out
    assert out.startswith("Evaluate a finished run again: `python -m ahnn.evaluate run=DIR")
    assert max(map(len, out.splitlines())) <= 100


def test_an_evaluation_never_touches_the_results_of_the_training(run):
    before = files(run)
    same = again(run)
    assert {path: content for path, content in files(run).items() if path in before} == before
    trained = load_results(run)
    assert same.rows == trained.rows
    assert same.training["val_loss"] == trained.training["val_loss"]
    assert same.training["seconds"] == trained.training["seconds"]
    assert same.training["data"] == "the test split of the run's data"
    assert call(EVALUATE, f"run={run}", "name=again") == 2  # its name is taken


def test_what_is_given_acts(run, caplog):
    before = load_results(run)
    changed = again(run, "system.stiffness=9", "label=nine: again")
    assert changed.label == "nine: again"
    assert changed.rows != before.rows
    said = "trajectories other than the training data; none was used in training"
    assert changed.training["data"] == said
    assert changed.rows[0].note.splitlines()[0] == f"test data: {said}"
    assert said in caplog.text
    assert "system.stiffness=9" in changed.about["command"] or changed.about["command"]


@pytest.mark.parametrize("chosen", [True, False])
def test_the_last_weights_are_the_best_only_where_nothing_chose_better_ones(run, capfd, caplog, chosen):
    best, last = (run / "checkpoints" / f"{n}.ckpt" for n in ("best", "last"))
    best.unlink()
    if chosen:
        for asked in ([], ["ckpt=best"]):
            said = refused(run, capfd, f"run={run}", *asked)
            assert "expected checkpoints/best.ckpt, the weights with the smallest val/loss" in said
        assert again(run, "ckpt=last").training["ckpt"] == "last"
        return
    content = read_checkpoint(last)
    content["ahnn"]["settings"]["callbacks.best.monitor"] = None
    torch.save(content, last)
    assert again(run).training["ckpt"] == "last"
    assert "no validation chose the best weights; the last ones are used" in caplog.text


def test_an_evaluation_weighs_residuals_as_the_training_did(run, capfd, monkeypatch):
    path, seen = run / "checkpoints" / "best.ckpt", []

    def case(*_, robust, **__):
        seen.append(robust)
        message = "as far as this test goes"
        raise UserError(message)

    monkeypatch.setattr("ahnn.jobs.evaluating.make_case", case)
    for robust in ("student", "cauchy", ["none"]):
        content = read_checkpoint(path)
        content["ahnn"]["settings"]["loss"]["robust"] = robust
        torch.save(content, path)
        assert call(EVALUATE, f"run={run}") == 2
    assert seen == ["student"]
    assert "received 'cauchy'" in capfd.readouterr().err


def test_a_run_that_was_moved_is_the_same_run(run, tmp_path):
    moved = run.rename(tmp_path / "moved")
    assert again(moved).rows == load_results(moved).rows


FILTER = ["plugins.ukf.cadence=10", "plugins.ukf.process_noise=[1e-6,1e-6]"]


@pytest.mark.parametrize("order", [1, -1])
def test_groups_come_before_keys_whatever_their_order(run, order):
    results = again(run, *["plugins=ukf", *FILTER][::order])
    assert results.numbers["ukf"]["updates"] == [10, 20, 30, 40, 50, 60]


def test_a_measurement_that_is_chosen_after_the_filter_acts(run):
    arguments = ["plugins=ukf", *FILTER, "measurement=state", "measurement.sd=[1e-3,1e-3]"]
    results = again(run, *arguments)
    assert results.numbers["ukf"]["measurement_sd"] == [1e-3, 1e-3]
    assert any(row.who == Who("model", "true", "ukf") for row in results.rows)


def test_a_shipped_model_is_not_judged_into_another_run(run, capfd):
    err = refused(run, capfd, f"pretrained={names()[0]}", f"run={run}")
    assert f"run {run}: expected a folder for" in err


@pytest.mark.parametrize("mistake", ["threads=many", "model.network.width=x", "plugins=ufk"])
def test_a_mistake_leaves_no_folder_of_a_shipped_model(tmp_path, capfd, mistake):
    refused(tmp_path, capfd, f"pretrained={names()[0]}", f"run={tmp_path / 'new'}", mistake)
    assert list(tmp_path.iterdir()) == []


def test_the_scores_of_shipped_models_are_in_the_schema_of_this_version():
    for name in names():
        content = json.loads((HERE / name / "metrics.json").read_text())
        assert content["schema"] == 2
        assert load_results(HERE / name).rows


def test_a_run_of_version_0_2_knew_of_no_biases(run):
    config = yaml.safe_load((run / "config.yaml").read_text())
    del config["measurement"]["bias_sd"], config["measurement"]["bias_memory"]
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    rows = again(run, "plugins=ukf", "plugins.ukf.cadence=10", "measurement.bias_sd=0.01").rows
    assert any(row.who.estimator == "ukf" for row in rows)
