"""Predictions of many starts: in blocks, by several workers, with broken trajectories among them."""

from __future__ import annotations

from pathlib import Path

import pytest
from entry import call
from test_predict import small

from ahnn.jobs import predicting_blocks
from ahnn.workers import Workers

STARTS = ["0.2,0.1", "0.1,-0.1", "0.15,0.0", "-0.1,0.05", "0.0,0.2"]
ASKED = ["run=run", "start=starts.csv", "start_sd=[1e-3,1e-3]", "duration=1"]


@pytest.fixture
def place(tmp_path, cache, monkeypatch):
    """A run whose parameters have a covariance, and five starts in blocks of two."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(predicting_blocks, "TOGETHER", 2)
    predicting_blocks._loaded.cache_clear()
    small(tmp_path / "run", cache, band=True)
    write(STARTS)
    return tmp_path


def write(starts, head="id,t [s],q [m],vq [m/s]"):
    """Write a table of starts."""
    rows = [f"s{k},0,{start}" for k, start in enumerate(starts)]
    Path("starts.csv").write_text("\n".join([head, *rows]) + "\n")


def rows_of(name, path):
    """The rows of one object in a table."""
    return [row for row in Path(path).read_text().splitlines() if row.startswith(f"{name},")]


@pytest.mark.usefixtures("place")
def test_blocks_are_predicted_in_order_each_once_and_as_alone(monkeypatch):
    sizes = []

    def mapped(workers, function, items):
        sizes.extend(len(item.states) for item in items)
        assert workers == ("processes", 3)
        return [function(item) for item in items]

    monkeypatch.setattr(Workers, "map", mapped)
    assert call("ahnn.predict", *ASKED, "output=shared.csv", "workers=3") == 0
    assert sizes == [2, 2, 1]
    assert call("ahnn.predict", *ASKED, "output=one.csv") == 0
    assert Path("shared.csv").read_bytes() == Path("one.csv").read_bytes()
    write(STARTS[2:4])
    assert call("ahnn.predict", *ASKED, "output=block.csv") == 0
    for own, name in (("s0", "s2"), ("s1", "s3")):
        alone = [row.partition(",")[2] for row in rows_of(own, "block.csv")]
        assert len(alone) == 11
        assert [row.partition(",")[2] for row in rows_of(name, "shared.csv")] == alone


ORBITS = ["0,-3145,-6173,10,0,0", "9,-3105,-6153,10,0,0", "20,-3125,-6163,10,0,0", "4,-3140,-6171,10,0,0"]
FAR = ["pretrained=molniya_mechanical", "start=starts.csv", "start_sd=[1e-3,1e-6]", "duration=3min"]


def test_a_broken_trajectory_is_reported_and_left_out(tmp_path, monkeypatch, caplog, capsys):
    monkeypatch.chdir(tmp_path)
    head = "id,t [s],x [km],y [km],z [km],vx [km/s],vy [km/s],vz [km/s]"
    write(ORBITS, head)
    assert call("ahnn.predict", *FAR, "output=sound.csv") == 0
    centre = "1e-300,0,0,0,0,0"
    write([*ORBITS[:2], centre, *ORBITS[3:]], head)
    assert call("ahnn.predict", *FAR, "output=broken.csv") == 0
    assert "s2: the prediction is NaN or infinite from 60 s after the start and is left out" in caplog.text
    assert rows_of("s2", "broken.csv") == []
    for name in ("s0", "s1", "s3"):
        assert rows_of(name, "broken.csv") == rows_of(name, "sound.csv") != []
    write([centre] * 2, head)
    assert call("ahnn.predict", *FAR, "output=none.csv") == 3
    assert "received NaN or infinity 60 s after start 1" in capsys.readouterr().err
    assert not Path("none.csv").exists()
    write([*ORBITS, *[centre] * 7], head)
    caplog.clear()
    assert call("ahnn.predict", *FAR, "output=some.csv") == 0
    assert [text for text in caplog.messages if "left out" in text][5:] == [
        "2 more of 11 trajectories are left out for the same reason"
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("place")
@pytest.mark.parametrize("workers", ["2", "ray:2"])
def test_processes_predict_the_same(workers):
    if workers.startswith("ray"):
        pytest.importorskip("ray", reason="the extra `ray` is needed")
    assert call("ahnn.predict", *ASKED, "output=one.csv") == 0
    assert call("ahnn.predict", *ASKED, f"workers={workers}", "output=shared.csv") == 0
    assert Path("shared.csv").read_bytes() == Path("one.csv").read_bytes()


@pytest.mark.usefixtures("place")
def test_what_is_no_number_of_workers_is_refused_before_any_work(place, capsys):
    assert call("ahnn.predict", *ASKED, "output=one.csv", "workers=two") == 2
    assert "workers: expected a number, such as 2, or ray:2; received 'two'" in capsys.readouterr().err
    assert not (place / "one.csv").exists()
