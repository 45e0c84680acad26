"""Evaluating a finished run: what may be changed and how, and mistakes that leave every file as it was."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from entry import SMALL, call

from ahnn.pretrained import names

EVALUATE = "ahnn.evaluate"
REMOVED = object()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run on the spring, which stays as it is."""
    folder = tmp_path_factory.mktemp("runs") / "spring"
    changes = ["trainer.max_epochs=1", "evaluation.figures=false", "evaluation.save_predictions=false"]
    assert call("ahnn.train", *SMALL, *changes, f"run={folder}") == 0
    return folder


@pytest.fixture
def run(finished, tmp_path):
    """A copy that a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def metrics(run):
    return json.loads((run / "metrics.json").read_text())


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
    assert files(folder) == before
    return err


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("model.network.width=12", r"model\.network\.width: expected 12, received 8"),
        ("model.hamiltonian=separable", r"model\.hamiltonian: expected separable, received generic"),
        ("system=molniya", r"system: expected a single key, system\.KEY=VALUE; received 'molniya'"),
        ("model=mlp", r"A finished run keeps its model; only the groups plugins and measurement"),
        ("data=null", r"data: expected a single key, data\.KEY=VALUE; received None"),
        ("label=[a", r"'label=\[a': special characters in a value need quotes"),
        ("seed=1,2", r"'seed=1,2': expected key=value with one value"),
        ("~plugins", "usage"),
        ("+label=a", r"'\+label=a': expected key=value with one value"),
        ("label={a: b}", r"label: expected str; received \{'a': 'b'\}"),
        ("evaluation.seed=x", r"evaluation\.seed: expected int from 0 to 4294967295; received 'x'"),
        ("measurement=null", r"measurement: expected the name of an option; received None"),
        ("plugins=3", r"plugins: expected the name of an option; received 3"),
        ("system.stifness=9", r"unknown key 'system\.stifness'; did you mean 'system\.stiffness'"),
        ("system.stiffness=nan", r"system mass_spring: stiffness: expected a finite number > 0"),
    ],
)
def test_an_override_that_does_not_fit_is_one_message(run, capfd, override, expected):
    assert re.search(expected, refused(run, capfd, f"run={run}", override))


@pytest.mark.parametrize(
    ("file", "content", "expected"),
    [
        ("config.yaml", "seed: [1\nlabel: }", r"config\.yaml: expected the YAML of a run; received"),
        (
            "config.yaml",
            "- seed\n- label",
            r"expected the configuration of a run; received one without system",
        ),
        ("config.yaml", "", r"expected the configuration of a run; received one without system, model"),
        ("config.yaml", "hello", r"expected the configuration of a run"),
        ("metrics.json", '{"seed": 7', r"metrics\.json: expected the scores of a run; received: .*Remove it"),
        ("metrics.json", "[1, 2]", r"metrics\.json: expected the scores of a run; received: \[1, 2\]"),
    ],
)
def test_a_damaged_file_of_a_run_is_one_message(run, capfd, file, content, expected):
    (run / file).write_text(content)
    assert re.search(expected, refused(run, capfd, f"run={run}"))


def test_a_flipped_bit_in_the_weights_is_one_message(run, capfd):
    path = run / "checkpoints" / "best.ckpt"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert "best.ckpt: expected an intact checkpoint" in refused(run, capfd, f"run={run}")


def test_help_says_how_to_use_it(capsys):
    assert call(EVALUATE, "--help") == 0
    assert "usage: python -m ahnn.evaluate run=DIR | pretrained=NAME" in capsys.readouterr().out


def test_what_was_changed_stands_beside_the_scores_until_it_is_undone(run):
    before = metrics(run)
    assert "overrides" not in before
    assert call(EVALUATE, f"run={run}", "system.stiffness=9", "label=nine: again") == 0
    changed = metrics(run)
    assert changed["overrides"] == ["system.stiffness=9", "label=nine: again"]
    assert changed["model"] == "nine: again"
    assert changed["rows"] != before["rows"]
    assert call(EVALUATE, f"run={run}", "plugins=null") == 0
    assert metrics(run) == {**before, "overrides": ["plugins=null"]}
    assert call(EVALUATE, f"run={run}") == 0
    assert metrics(run) == before


UKF = ["plugins.ukf.cadence=10", "plugins.ukf.process_noise=[1e-6,1e-6]"]


@pytest.mark.parametrize("order", [1, -1])
def test_groups_come_before_keys_whatever_their_order(run, order):
    assert call(EVALUATE, f"run={run}", *["plugins=ukf", *UKF][::order]) == 0
    assert metrics(run)["ukf"]["updates"] == [10, 20, 30, 40, 50, 60]


def old(run):
    """Make the folder of a run with the filter as it was before it had all of its options."""
    options = {"measurement": None, "measurement_sd": None, "process_noise": [1e-6, 1e-6], "cadence": 20}
    constants = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0, "form": "square_root", "gate": None, "seed": 3}
    target = {"_target_": "ahnn_plugins.ukf.plugin.UKFEvaluation"}
    store(run, plugins={"ukf": {**target, **options, **constants, "smoother": False, "tuning": None}})


def test_a_filter_of_an_older_run_takes_the_options_that_it_lacks_and_keeps_its_own(run):
    old(run)
    assert call(EVALUATE, f"run={run}", "plugins.ukf.patience=3") == 0
    found = metrics(run)["ukf"]
    assert found["updates"] == [20, 40, 60]
    assert found["seed"] == 3
    assert found["measured"] == ["q1"]


@pytest.mark.parametrize("key", ["system", "label", "evaluation"])
def test_a_configuration_without_a_part_is_named(run, capfd, key):
    store(run, **{key: REMOVED})
    assert f"expected the configuration of a run; received one without {key}" in refused(
        run, capfd, f"run={run}"
    )


def test_a_trained_model_is_not_installed_over_a_run(run, capfd):
    err = refused(run, capfd, f"pretrained={names()[0]}", f"run={run}")
    assert f"received {run}, which holds another run" in err


@pytest.mark.parametrize("mistake", ["threads=many", "model.network.width=x", "plugins=ufk"])
def test_a_mistake_leaves_no_folder_of_a_trained_model(tmp_path, capfd, mistake):
    refused(tmp_path, capfd, f"pretrained={names()[0]}", f"run={tmp_path / 'new'}", mistake)
    assert list(tmp_path.iterdir()) == []
