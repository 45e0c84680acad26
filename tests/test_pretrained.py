"""Trained weights that come with the package load, and predict the reference orbits they have never seen."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from ahnn import load
from ahnn.checkpoints import checksum
from ahnn.cli.reevaluation import Request, run_config
from ahnn.errors import UserError
from ahnn.evaluation import Who
from ahnn.pretrained import HERE, names

ORBITS = Path(__file__).parent / "fixtures" / "j2_orbits.csv"


def reference(orbit: str) -> torch.Tensor:
    """States at 0, 60, 600 s of an orbit of the fixture, shape (3, 6)."""
    lines = [line for line in ORBITS.read_text().splitlines() if not line.startswith("#")]
    rows = [list(row.values()) for row in csv.DictReader(lines) if row["orbit"] == orbit]
    return torch.tensor([[float(v) for v in row[2:8]] for row in rows[:3]], dtype=torch.float64)


def test_there_are_trained_models():
    assert names()


@pytest.mark.parametrize("name", names())
def test_a_trained_model_follows_a_reference_orbit_past_periapsis(name):
    run, states = load(name), reference("0")
    x = run.rollout(states[0], steps=10)[:, -1]
    travelled = (states[2, :3] - states[0, :3]).norm()
    assert (x[0, :3] - states[2, :3]).norm() < 1e-4 * travelled
    energies = run.energy(torch.stack((states[0], x[0])))
    assert float((energies[1] - energies[0]).abs()) < 1e-3 * float(energies.abs().max())


@pytest.mark.parametrize("name", names())
def test_a_trained_model_says_what_it_is(name):
    run = load(name)
    assert run.space.name.startswith("molniya")
    assert run.dt == 60.0
    assert run.space.units.position == "km"
    assert run.config["data"]["trajectories"] == 2500
    row = run.results.row(Who("model", "true"))
    assert row is not None
    assert 0 < row.scores.position < 200


@pytest.mark.parametrize("name", names())
def test_a_trained_model_names_no_folder_of_the_machine_it_was_made_on(name):
    text = (HERE / name / "config.yaml").read_text() + (HERE / name / "metrics.json").read_text()
    assert "/tmp" not in text
    assert "/work" not in text
    assert "/home" not in text


def test_an_unknown_name_is_refused_with_the_names_that_there_are():
    with pytest.raises(
        UserError, match=rf"expected a run folder or one of .*{names()[0]}.*received 'molnya'"
    ):
        load("molnya")


@pytest.fixture
def copy(tmp_path):
    """The folder of a shipped model, to be damaged."""
    return Path(shutil.copytree(HERE / names()[0], tmp_path / "copy"))


def test_damaged_weights_are_one_message(copy):
    path = copy / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"weights\.safetensors: expected an intact .* a damaged one"):
        load(copy)


def test_weights_of_another_model_are_one_message(copy):
    path = copy / "weights.safetensors"
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        content = {key: file.get_tensor(key) for key in list(file.keys())[1:]}
    save_file(content, path, {**metadata, "sha256": checksum(content, metadata["ahnn"])})
    with pytest.raises(UserError, match=r"received weights of a different model .*Missing key"):
        load(copy)


def test_weights_of_another_format_are_one_message(copy):
    save_file({"x": torch.ones(2)}, copy / "weights.safetensors")
    with pytest.raises(UserError, match=r"expected format 2; received an earlier one"):
        load(copy)


@pytest.mark.parametrize("name", names())
def test_a_trained_model_has_all_that_an_evaluation_builds_from(name):
    request = Request.of([f"pretrained={name}", "plugins=none"])
    assert run_config(HERE / name, request).measurement.model == "position"
