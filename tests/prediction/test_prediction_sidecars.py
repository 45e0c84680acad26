"""Sidecars of predictions: one for each table."""

from __future__ import annotations

from entry import call

MOLNIYA, START = "pretrained=molniya_mechanical", "start=[0,-3145,-6173,10,0,0]"


def test_tables_do_not_share_a_sidecar(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    short = ["duration=10min", "step=5min"]
    assert call("ahnn.predict", MOLNIYA, START, *short, "output=orbit.csv") == 0
    before = (tmp_path / "orbit.yaml").read_bytes()
    assert call("ahnn.predict", MOLNIYA, START, *short, "output=orbit.parquet") == 2
    said = "output: expected a name of its own, since orbit.yaml describes orbit.csv"
    assert said in capfd.readouterr().err
    assert (tmp_path / "orbit.yaml").read_bytes() == before
    assert not (tmp_path / "orbit.parquet").exists()
    assert call("ahnn.predict", MOLNIYA, START, *short, "output=orbit.csv") == 0
