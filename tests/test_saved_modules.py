"""Filters whose process model is a module saved by `ahnn.save`."""

from __future__ import annotations

import csv

import pytest
from entry import call
from test_torch_modules import SPACE, free

import ahnn


def test_a_saved_model_filters_a_stream_with_given_process_noise(tmp_path, capfd):
    """Without a force, H = p^2 / 2: the first update against the formulas of a Kalman filter."""
    ahnn.save(free(), SPACE, 0.1, tmp_path / "mine")
    (tmp_path / "seen.csv").write_text("time,q\n0.1,0.9\n")
    command = [f"run={tmp_path / 'mine'}", f"measurements={tmp_path / 'seen.csv'}", "measurement.sd=0.05"]
    command += ["start=[1,0]", "start_sd=[0.1,0.1]", f"output={tmp_path / 'track.csv'}"]
    assert call("ahnn.assimilate", *command) == 2
    assert "has no data to which they can be fitted" in capfd.readouterr().err
    assert not (tmp_path / "track.csv").exists()
    assert call("ahnn.assimilate", *command, "plugins.ukf.process_noise=[1e-3,1e-3]") == 0
    (row,) = csv.DictReader((tmp_path / "track.csv").read_text().splitlines())
    predicted = 0.1**2 + (0.1 * 0.1 / SPACE.inertia) ** 2 + 1e-3**2
    gain = predicted / (predicted + 0.05**2)
    assert float(row["q"]) == pytest.approx(1.0 - 0.1 * gain, rel=1e-9)
    assert float(row["cov_q_q"]) == pytest.approx((1.0 - gain) * predicted, rel=1e-9)


def test_an_evaluation_of_a_saved_model_names_what_it_lacks(tmp_path, capfd):
    ahnn.save(free(), SPACE, 0.1, tmp_path / "mine")
    assert call("ahnn.evaluate", f"run={tmp_path / 'mine'}") == 2
    assert "expected a run with its data; received a model written by ahnn.save" in capfd.readouterr().err
