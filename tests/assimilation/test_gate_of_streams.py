"""The gate that streams have where nobody says anything: on, of a known rate, and off in evaluations."""

from __future__ import annotations

import pytest
import torch
from entry import call
from evaluating import composed
from scipy.stats import chi2

import ahnn
from ahnn.cli.build import build_all
from ahnn.estimation.gate import Gate, thresholds

NAMES = ("ukf", "ckf", "ghkf", "ekf", "enkf", "particle", "imm")


@pytest.mark.parametrize("name", NAMES)
def test_streams_have_a_gate_by_default_and_evaluations_none(name):
    cfg = composed(name, "position")
    (plugin,) = build_all(cfg.plugins, "plugins").values()
    assert plugin.estimator.gate is None
    assert plugin.streamed.gate == Gate(0.9999, 5)
    for given, both in ((None, None), (0.99, Gate(0.99, 5))):
        cfg.plugins[name].gate = given
        (plugin,) = build_all(cfg.plugins, "plugins").values()
        assert plugin.estimator.gate == plugin.streamed.gate == both


def test_it_refuses_one_in_ten_thousand_of_what_it_should_take():
    """The false-alarm probability that the documents state."""
    for count, limit in enumerate(thresholds(Gate(0.9999), 6).tolist()[1:], 1):
        assert chi2.sf(limit, count) == pytest.approx(1e-4, rel=1e-6)


def test_a_stream_refuses_an_outlier_and_says_so_and_takes_it_without(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    start = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
    fixes = ahnn.load("molniya_mechanical").rollout(start, 12, 15.0)[0][:, :3]
    noise = 0.05 * torch.randn(fixes.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fixes = fixes + noise
    fixes[5, 1] += 3.0
    rows = [f"{15.0 * k},{x},{y},{z}" for k, (x, y, z) in enumerate(fixes.tolist())]
    (tmp_path / "fixes.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    given = ["pretrained=molniya_mechanical", "plugins=ukf", "plugins.ukf.process_noise=[1e-3,1e-5]"]
    given += [f"start={start}", "start_sd=[0.1,1e-4]", "measurement.sd=0.05", "measurements=fixes.csv"]
    assert call("ahnn.assimilate", *given, "output=gated.csv") == 0
    assert "14 lines: 1 rejected, 12 taken" in caplog.messages
    assert any("rejected, NIS" in message for message in caplog.messages)
    assert call("ahnn.assimilate", *given, "plugins.ukf.gate=null", "output=all.csv") == 0
    assert "14 lines: 13 taken" in caplog.messages
