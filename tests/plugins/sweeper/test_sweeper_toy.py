"""The sweeper end to end on an objective that costs nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from sweeps import APP, ROOT, SEARCH, assert_none_lost_or_doubled, forked_sweep, states, sweep, trials

from ahnn.evaluation.sweep_summary import PRUNED

pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")


@pytest.mark.slow
def test_states_files_and_resume(tmp_path: Path):
    folder = tmp_path / "sweep"
    code, output = sweep(folder, *SEARCH, "hydra.sweeper.n_trials=4", "prune_above=0.8")
    assert code == 0, output
    assert "sweep 4/4  best" in output
    code, output = sweep(folder, *SEARCH, "hydra.sweeper.n_trials=8", "prune_above=0.8")
    assert code == 0, output
    found = trials(folder)
    assert_none_lost_or_doubled(found, 8)
    assert [t.state.name == "PRUNED" for t in found] == [t.params["x"] > 0.8 for t in found]
    marked = [(folder / str(t.number) / PRUNED).exists() for t in found]
    assert marked == [t.state.name == "PRUNED" for t in found]
    assert 0 < states(found).count("PRUNED") < 8
    assert {path.name for path in folder.iterdir() if path.is_dir()} == {"experiment", *map(str, range(8))}
    for name in ("best.yaml", "history.png", "importance.png", "parallel.png", "multirun.yaml"):
        assert (folder / name).stat().st_size > 0


def test_a_failing_job_stops_nothing_and_sets_the_exit_code(tmp_path: Path):
    folder = tmp_path / "sweep"
    code, output = forked_sweep(folder, *SEARCH, "hydra.sweeper.n_trials=4", "raising=[1]")
    assert code == 1
    assert "1 of 4 trials failed" in output
    assert "RuntimeError: this job was made to fail" in output
    assert states(trials(folder)) == ["COMPLETE", "FAIL", "COMPLETE", "COMPLETE"]


def test_the_winner_runs_again_as_an_experiment(tmp_path: Path):
    folder = tmp_path / "sweep"
    arguments = ("sweep=quick", "model=hnn", "hydra.sweeper.n_trials=2")
    code, output = forked_sweep(folder, *arguments)
    assert code == 0, output
    best = yaml.safe_load((folder / "best.yaml").read_text())
    assert {"override /model": "hnn"} in best["defaults"]
    again = tmp_path / "7"
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'plugins'}:{ROOT}", "AHNN_CONF": str(ROOT / "conf")}
    command = [
        sys.executable,
        str(APP),
        "--config-dir",
        str(folder),
        "experiment=best",
        f"hydra.run.dir={again}",
    ]
    subprocess.run(command, check=True, env=environment, cwd=tmp_path, capture_output=True)
    config = yaml.safe_load((again / ".hydra" / "config.yaml").read_text())
    assert config["model"]["name"] == "hnn"
    assert config["model"]["network"] == {"activation": "gelu"} | best["model"]["network"]
    assert config["optimizer"]["lr"] == best["optimizer"]["lr"]
    assert config["trainer"]["max_epochs"] == 20  # from sweep=quick


@pytest.mark.parametrize(
    ("space", "rates"), [(("sweep=paper", "model=hnn"), (1e-4, 1e-3)), (("sweep=paper_node",), (1e-6, 1e-4))]
)
@pytest.mark.sampled(2)
def test_the_papers_spaces_compose(tmp_path: Path, space: tuple[str, ...], rates: tuple[float, float]):
    folder = tmp_path / "sweep"
    code, output = forked_sweep(folder, *space, "hydra.sweeper.n_trials=1", "hydra/launcher=basic")
    assert code == 0, output
    job = yaml.safe_load((folder / "0" / ".hydra" / "config.yaml").read_text())
    assert job["seeds"] == [7, 201, 719]
    assert 3 <= job["model"]["network"]["depth"] <= 10
    assert job["scheduler"]["upper_bound"] in (300, 350, 400)
    assert rates[0] <= job["optimizer"]["lr"] <= rates[1]
    assert job["scheduler"]["infimum_lr"] < job["optimizer"]["lr"]
    assert job["callbacks"]["pfl"]["trial"] == "${trial}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hydra/sweeper=ahnn_optuna",), "expected at least one key to search"),
        ((*SEARCH, "y=interval(0.0,1.0)"), "Key 'y' is not in struct"),
        ((*SEARCH, "hydra.sweeper.storage=mysql://host/db"), "sweeper storage: expected"),
    ],
)
def test_user_mistakes_stop_before_the_first_job(tmp_path: Path, arguments: tuple[str, ...], message: str):
    code, output = forked_sweep(tmp_path / "sweep", *arguments)
    assert code == 1
    assert message in output
    assert not (tmp_path / "sweep" / "0").exists()


def test_another_command_does_not_continue_a_study(tmp_path: Path):
    assert forked_sweep(tmp_path / "sweep", *SEARCH, "hydra.sweeper.n_trials=1")[0] == 0
    code, output = forked_sweep(tmp_path / "sweep", *SEARCH, "hydra.sweeper.n_trials=2", "model=hnn")
    assert code == 1
    assert "expected to be continued with" in output
    assert len(trials(tmp_path / "sweep")) == 1
