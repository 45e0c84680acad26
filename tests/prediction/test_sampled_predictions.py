"""`python -m ahnn.predict samples=N`: moments of sampled paths in the files."""

from __future__ import annotations

import csv
import io

import torch
from entry import call
from helpers import close

import ahnn

MOLNIYA = "pretrained=molniya_mechanical"
STATE = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
START = f"start={STATE}".replace(" ", "")


def rows(path):
    return list(csv.DictReader(io.StringIO(path.read_text())))


def column(found, name):
    return torch.tensor([float(row[name]) for row in found], dtype=torch.float64)


def test_sampled_starts_have_exactly_the_given_covariance_and_linear_motion_keeps_it():
    """Errors of 1 m and 1 mm/s remain in the linear range for an hour; with 20 draws they are random."""
    run, sd, times = ahnn.load("molniya_mechanical"), [1e-3, 1e-6], 600.0 * torch.arange(7.0)
    linear = run.predict(STATE, times, start_sd=sd)
    many = run.predict(STATE, times, start_sd=sd, samples=200)
    close(many.covariances[0, 0], linear.covariances[0, 0], 1e-9)
    close(many.deviations[0], linear.deviations[0], 1e-4)
    few = run.predict(STATE, times, start_sd=sd, samples=20)
    assert float((few.deviations / linear.deviations - 1).abs().max()) > 0.02


def test_sampled_paths_are_written_in_place_of_first_order_bands(tmp_path, monkeypatch, caplog):
    """Their moments are those of the library, also in another frame, and no linear range is left."""
    monkeypatch.chdir(tmp_path)
    run, sd = ahnn.load("molniya_mechanical"), [3.0, 3e-3]
    options = [f"start_sd=[{sd[0]},{sd[1]}]", "duration=6h", "step=90min", "samples=20"]
    assert call("ahnn.predict", MOLNIYA, START, *options, "output=wide.csv") == 0
    assert "propagate linearly" not in caplog.text
    expected = run.predict(STATE, 5400.0 * torch.arange(5.0), start_sd=sd, samples=20)
    found = rows(tmp_path / "wide.csv")
    for k, name in enumerate(("x", "y", "z")):
        close(column(found, f"{name} [km]"), expected.states[0, :, k], 1e-12)
        close(column(found, f"sd_{name} [km]"), expected.deviations[0, :, k], 1e-9)
    framed = [*options, "epoch=2024-03-01T12:00:00", "frame=EME2000", "output_frame=GCRF"]
    assert call("ahnn.predict", MOLNIYA, START, *framed, "output=turned.csv") == 0
    turned = torch.stack([column(rows(tmp_path / "turned.csv"), f"{name} [km]") for name in "xyz"], dim=1)
    close(turned.norm(dim=1), expected.states[0, :, :3].norm(dim=1), 1e-12)
    refused = [START, "duration=12h", "samples=20"]
    assert call("ahnn.predict", MOLNIYA, *refused) == 2
