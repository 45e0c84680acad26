"""Trained weights that come with the package load, and predict the reference orbits they have never seen."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import load_file, save_file

from ahnn.errors import UserError
from ahnn.evaluation.report import restore
from ahnn.pretrained import FILES, HERE, best_weights, install, names
from ahnn.train import build_parts

ORBITS = Path(__file__).parent / "fixtures" / "j2_orbits.csv"


def reference(orbit: str) -> torch.Tensor:
    """States at 0, 60, 600 s of an orbit of the fixture, shape (3, 6)."""
    lines = [line for line in ORBITS.read_text().splitlines() if not line.startswith("#")]
    rows = [list(row.values()) for row in csv.DictReader(lines) if row["orbit"] == orbit]
    return torch.tensor([[float(v) for v in row[2:8]] for row in rows[:3]], dtype=torch.float64)


def test_there_are_trained_models():
    assert names()


@pytest.mark.parametrize("name", names())
def test_a_trained_model_follows_a_reference_orbit_past_periapsis(name, tmp_path):
    install(name, tmp_path / "run")
    cfg = OmegaConf.load(tmp_path / "run" / "config.yaml")
    cfg.data.cache = str(tmp_path)
    _, model = build_parts(cfg)
    restore(model, tmp_path / "run")
    states = reference("0")
    x, flow = states[:1], model.flow()
    for _ in range(10):
        x = flow(x, 60.0)
    travelled = (states[2, :3] - states[0, :3]).norm()
    assert (x[0, :3] - states[2, :3]).norm() < 1e-4 * travelled


@pytest.mark.parametrize("name", names())
def test_a_trained_model_names_no_folder_of_the_machine_it_was_made_on(name):
    text = (HERE / name / "config.yaml").read_text() + (HERE / name / "metrics.json").read_text()
    assert "/tmp" not in text
    assert "/work" not in text
    assert "/home" not in text


def test_an_unknown_name_is_refused_with_the_nearest_one(tmp_path):
    with pytest.raises(UserError, match="did you mean"):
        install(names()[0] + "x", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("own", ["config.yaml", "checkpoints/best.ckpt"])
def test_a_folder_with_another_run_is_refused_and_kept(tmp_path, own):
    (tmp_path / own).parent.mkdir(exist_ok=True)
    (tmp_path / own).write_text("mine")
    with pytest.raises(UserError, match=r"holds another run.*run=DIR"):
        install(names()[0], tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [own.split("/")[0]]
    assert (tmp_path / own).read_text() == "mine"


def test_a_folder_of_the_same_model_is_made_whole_again(tmp_path):
    install(names()[0], tmp_path)
    (tmp_path / "weights.safetensors").write_bytes(b"damaged")
    (tmp_path / "metrics.json").unlink()
    install(names()[0], tmp_path)
    for file in FILES:
        assert (tmp_path / file).read_bytes() == (HERE / names()[0] / file).read_bytes()


def test_damaged_weights_are_one_message(tmp_path):
    install(names()[0], tmp_path)
    path = tmp_path / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"weights\.safetensors: expected an intact .* a damaged one"):
        best_weights(tmp_path)


def test_weights_of_another_model_are_one_message(tmp_path):
    install(names()[0], tmp_path)
    _, model = build_parts(OmegaConf.load(tmp_path / "config.yaml"))
    content = load_file(tmp_path / "weights.safetensors")
    content.pop(next(iter(content)))
    save_file(content, tmp_path / "weights.safetensors")
    with pytest.raises(UserError, match=r"expected the weights of its model; received others .*Missing key"):
        restore(model, tmp_path)
