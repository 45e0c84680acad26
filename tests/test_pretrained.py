"""Trained weights that come with the package load, and predict the reference orbits they have never seen."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from ahnn.errors import UserError
from ahnn.pretrained import HERE, best_weights, install, names
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
    weights, _ = best_weights(tmp_path / "run")
    model.load_state_dict(weights)
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
