"""`python -m ahnn.predict`: files in, files out, and one message for each mistake."""

from __future__ import annotations

import csv
import io
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from entry import call
from helpers import close
from test_predict import small

import ahnn
from ahnn.data.files import Ephemeris, Files, instant, read_oem, write_oem
from ahnn.data.files.parquet import packed_table
from ahnn.pretrained import names
from ahnn.uncertainty import save_uncertainty

MOLNIYA = "pretrained=molniya_mechanical"
STATE = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
START = f"start={STATE}".replace(" ", "")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows(path):
    return list(csv.DictReader(io.StringIO(path.read_text())))


def column(found, name):
    return torch.tensor([float(row[name]) for row in found], dtype=torch.float64)


def test_bands_too_wide_for_first_order_are_said_to_be(here, caplog):
    """A start known to 1 km and 1 m/s: a revolution later it may be anywhere in thousands of km.

    One known to 10 m may be anywhere along 20 km of a curved track, out of its flat joint covariance.
    """
    for sd, bands, joint in ((1e-6, False, False), (0.01, False, True), (1.0, True, True)):
        options = [f"start_sd=[{sd},{sd / 1000}]", "duration=12h", "step=1h", "output=wide.csv"]
        assert call("ahnn.predict", MOLNIYA, START, *options) == 0
        for what, said in (("bands: from about", bands), ("joint covariance: from about", joint)):
            assert (what in caplog.text) is said
            assert (what in (here / "wide.yaml").read_text()) is said
        assert caplog.text.count("samples=200") == (bands or joint)
        caplog.clear()
        (here / "wide.csv").unlink()


def test_a_table_holds_the_prediction_and_can_be_read_again(here, capsys):
    assert call("ahnn.predict", MOLNIYA, START, "duration=1h", "step=10min", "output=orbit.csv") == 0
    run, found = ahnn.load("molniya_mechanical"), rows(here / "orbit.csv")
    orbit = run.rollout(STATE, steps=60)[0, ::10]
    names = ["x [km]", "y [km]", "z [km]", "vx [km/s]", "vy [km/s]", "vz [km/s]"]
    written = torch.tensor([[float(row[name]) for name in names] for row in found], dtype=torch.float64)
    close(written, orbit, 1e-14)
    assert [float(row["t [s]"]) for row in found] == [600.0 * k for k in range(7)]
    close(column(found, "novelty [1]"), run.novelty(orbit), 1e-6)
    assert "sd_x [km]" not in found[0]  # trained on exact states: nobody knows
    out = capsys.readouterr().out
    assert "7 states over 3600 s" in out
    assert "not known" in out
    (here / "orbit.yaml").write_text(
        "columns: {time: t, id: id, positions: [x, y, z], velocities: [vx, vy, vz]}\n"
    )
    close(Files("again", "orbit.csv").read().states[0], orbit, 1e-14)


def test_a_message_goes_on_where_another_begins(here):
    epoch = instant("2016-12-31T23:30:00", utc=True)  # a leap second lies half an hour ahead
    states = np.array([STATE, STATE])
    write_oem(
        "start.oem", [Ephemeris("A", "A", "EARTH", "EME2000", "UTC", epoch, np.array([0.0, 1.0]), states)]
    )
    assert call("ahnn.predict", MOLNIYA, "start=start.oem", "duration=1h", "output=orbit.oem") == 0
    (found,) = read_oem("orbit.oem")
    assert (found.object_id, found.frame, found.center) == ("A", "EME2000", "EARTH")
    assert found.start == epoch
    assert found.times[-1] == 3600.0
    assert "2017-01-01T00:29:59.000" in (here / "orbit.oem").read_text()
    close(torch.from_numpy(found.states), ahnn.load("molniya_mechanical").rollout(STATE, steps=60)[0], 1e-14)
    assert call("ahnn.predict", MOLNIYA, "start=start.oem", "duration=1min", "output=o.csv") == 0
    assert rows(here / "o.csv")[1]["epoch"] == "2016-12-31T23:31:00.000"


@pytest.mark.usefixtures("here")
def test_what_is_not_used_of_a_start_is_said(caplog):
    states = np.array([STATE, STATE])
    epoch = instant("2024-03-01", utc=True)
    orbit = Ephemeris("A", "A", "EARTH", "EME2000", "UTC", epoch, np.array([0.0, 1.0]), states)
    write_oem("start.oem", [orbit])
    text = Path("start.oem").read_text()
    Path("start.oem").write_text(text.replace("META_STOP", "INTERPOLATION = HERMITE\nMETA_STOP"))
    assert call("ahnn.predict", MOLNIYA, "start=start.oem", "duration=1min") == 0
    assert "not used: INTERPOLATION" in caplog.text


def test_a_band_reaches_every_format_in_its_units(here, cache):
    pytest.importorskip("pyarrow", reason="the extra `parquet` is needed")
    import pyarrow.parquet as pq

    run = small(here / "run", cache, band=True)
    (here / "start.csv").write_text("id,t [ms],q [cm],vq [cm/s]\nb,500,20,10\na,0,10,-5\n")
    assert call("ahnn.predict", "run=run", "start=start.csv", "duration=2s", "output=out.parquet") == 0
    table = pq.read_table("out.parquet").to_pydict()
    assert table["id"] == ["b"] * 21 + ["a"] * 21
    assert table["t [s]"][:2] == pytest.approx([0.5, 0.6])
    start = torch.tensor([[0.2, 0.2], [0.1, -0.1]], dtype=torch.float64)  # 2 kg: momenta are twice as large
    found = run.predict(start, run.dt * torch.arange(21.0, dtype=torch.float64))
    close(torch.tensor(table["vq [m/s]"], dtype=torch.float64), found.states[..., 1].flatten() / 2, 1e-12)
    assert found.deviations is not None
    close(torch.tensor(table["sd_q [m]"], dtype=torch.float64), found.deviations[..., 0].flatten(), 1e-6)
    close(
        torch.tensor(table["sd_vq [m/s]"], dtype=torch.float64), found.deviations[..., 1].flatten() / 2, 1e-6
    )


def test_several_trainings_show_their_spread_and_a_picture(here, cache, capsys, caplog):
    one, other = small(here / "one", cache), small(here / "other", cache, seed=1)
    arguments = ["run=[one,other]", "start=[0.2,0.1]", "duration=1", "output=out.csv", "figure=out.png"]
    assert call("ahnn.predict", *arguments) == 0
    both = torch.stack([run.rollout([0.2, 0.1], steps=10)[0, :, 0] for run in (one, other)])
    found = rows(here / "out.csv")
    close(column(found, "q [m]"), both.mean(0), 1e-6)
    close(column(found, "sd_q [m]"), both.std(0), 1e-6)
    small(here / "known", cache, seed=2, band=True)
    mixed = ["run=[known,one]", "start=[0.2,0.1]", "start_sd=[1e-9,1e-9]", "duration=1", "output=mixed.csv"]
    assert call("ahnn.predict", *mixed) == 0
    assert "1 sigma: from the start and the differences between the runs" in caplog.text
    pair = torch.stack([ahnn.load(name).rollout([0.2, 0.1], steps=10)[0, :, 0] for name in ("known", "one")])
    close(column(rows(here / "mixed.csv"), "sd_q [m]")[1:], pair.std(0)[1:], 1e-3)
    assert (here / "out.png").read_bytes()[:4] == b"\x89PNG"
    assert "one + other" in capsys.readouterr().out


def test_a_training_that_ended_before_its_optimum_is_named_once(here, cache, caplog):
    for name, remaining in (("one", 3.0), ("other", 2.0)):
        run = small(here / name, cache, band=True)
        found = replace(run.uncertainty, about={"determined": 2.5, "remaining": remaining})
        save_uncertainty(here / name, found, run.dynamics.state_dict())
    arguments = ["start=[0.2,0.1]", "duration=1"]
    assert call("ahnn.predict", "run=other", *arguments) == 0
    ahnn.load("other")
    assert "optimum" not in caplog.text
    assert call("ahnn.predict", "run=[other,one]", *arguments) == 0
    assert caplog.text.count("run one: the training ended before its optimum") == 1
    assert call("ahnn.predict", "run=[other,one]", *arguments, "output=out.csv") == 0
    assert (here / "out.yaml").read_text().count("# run one: the training ended before its optimum") == 1


@pytest.mark.slow
def test_a_start_with_standard_deviations_has_a_band_that_goes_along_with_it(here, cache, caplog):
    arguments = [MOLNIYA, START, "duration=1d", "step=1d", "output=orbit.csv"]
    assert call("ahnn.predict", *arguments, "start_sd=[1,0.001]") == 0
    assert "from the start only; these weights carry no uncertainty in the dynamics" in caplog.text
    first, last = rows(here / "orbit.csv")
    known = [float(first[f"sd_{name}"]) for name in ("x [km]", "z [km]", "vy [km/s]")]
    assert known == pytest.approx([1, 1, 0.001], rel=1e-15)
    run = ahnn.load("molniya_mechanical")
    nudges = torch.eye(6, dtype=torch.float64) * torch.tensor([1.0] * 3 + [1e-3] * 3)
    start = torch.tensor(STATE, dtype=torch.float64)
    ends = run.rollout(torch.cat((start + 1e-3 * nudges, start - 1e-3 * nudges)), steps=1440)[:, -1]
    moved = (ends[:6] - ends[6:]) / 2e-3
    expected = moved.square().sum(0).sqrt()
    found = [float(last[f"sd_{name}"]) for name in ("x [km]", "y [km]", "z [km]", "vx [km/s]")]
    close(torch.tensor(found), expected[:4].float(), 1e-3)
    times = 3600.0 * torch.arange(25, dtype=torch.float64)
    everywhere = run.predict(STATE, times, start_sd=torch.tensor([1.0, 1e-3])).covariances
    unit = everywhere.diagonal(dim1=-2, dim2=-1).rsqrt()
    assert float(torch.linalg.eigvalsh(everywhere * unit[..., None] * unit[..., None, :]).min()) > -1e-14
    caplog.clear()
    small(here / "run", cache, band=True)
    assert call("ahnn.predict", "run=run", "start=[0.2,0.1]", "start_sd=[1,1]", "duration=1") == 0
    assert caplog.text == ""


def test_leaving_the_training_data_is_one_line_and_a_flag(here, caplog):
    slow = [0.0, -3145.0, -6173.0, 9.0, 0.0, 0.0]
    arguments = [f"start={slow}".replace(" ", ""), "duration=90min", "output=out.csv"]
    assert call("ahnn.predict", MOLNIYA, *arguments) == 0
    (said,) = (text for text in caplog.messages if not text.startswith("predicting"))  # progress after 10 s
    assert "novelty: 8" in said
    assert "beyond the training data" in said
    found = rows(here / "out.csv")
    assert found[0]["novel [1]"] == "0"
    assert found[-1]["novel [1]"] == "1"
    assert "read as" not in said  # the start itself is within
    caplog.clear()
    assert call("ahnn.predict", MOLNIYA, START, "duration=1d") == 0
    assert "novelty" not in caplog.text


def test_numbers_far_from_the_training_data_are_told_with_the_units_in_which_they_are_read(here, caplog):
    metres = [1e3 * value for value in STATE]
    assert call("ahnn.predict", MOLNIYA, f"start={metres}".replace(" ", ""), "duration=10") == 0
    assert "The numbers in start= are read as x [km], y [km], z [km], px [km/s], " in caplog.text
    caplog.clear()
    (here / "start.yaml").write_text(f"mean: {metres}\n")
    assert call("ahnn.predict", MOLNIYA, "start=start.yaml", "duration=10") == 0
    assert "beyond the training data" in caplog.text
    assert "read as" not in caplog.text


def test_weights_of_an_earlier_version_say_that_novelty_is_not_known(here, cache, caplog):
    small(here / "run", cache, domain=False)
    assert call("ahnn.predict", "run=run", "start=[0.2,0.1]", "duration=1", "output=out.csv") == 0
    assert "novelty: unknown" in caplog.text
    assert "novelty [1]" not in rows(here / "out.csv")[0]


MISTAKES = {
    "nothing": ([], "usage: python -m ahnn.predict"),
    "no run": ([START, "duration=1"], "expected run=DIR or pretrained=NAME; received neither"),
    "unknown run": (["run=nowhere", START, "duration=1"], "expected a run folder or one of"),
    "no start": ([MOLNIYA, "duration=1"], "expected key 'start'"),
    "size": ([MOLNIYA, "start=[1,2]", "duration=1"], "x [km], y [km], z [km], px [km/s]"),
    "nan": ([MOLNIYA, "start=[nan,0,0,0,0,0]", "duration=1"], "start: expected finite numbers"),
    "words": ([MOLNIYA, "start=[a,b,0,0,0,0]", "duration=1"], "start: expected"),
    "ragged": ([MOLNIYA, "start=[[1],[1,2]]", "duration=1"], "start: expected"),
    "no file": ([MOLNIYA, "start=none.csv", "duration=1"], "none.csv"),
    "duration": ([MOLNIYA, START, "duration=1km"], "duration: expected a positive duration"),
    "step": ([MOLNIYA, START, "duration=1h", "step=0"], "step: expected a positive duration"),
    "too long": ([MOLNIYA, START, "duration=1e18"], "duration and step: expected"),
    "too short a step": ([MOLNIYA, START, "duration=1d", "step=1e-320"], "duration and step: expected"),
    "suffix": ([MOLNIYA, START, "duration=1h", "output=out.xls"], "output: expected a .csv"),
    "folder": ([MOLNIYA, START, "duration=1h", "output=no/out.csv"], ".xml file in an existing folder"),
    "picture": ([MOLNIYA, START, "duration=1h", "figure=out.gif"], "figure: expected a .png or .svg file"),
    "frame": ([MOLNIYA, START, "duration=1h", "output=o.oem"], "frame: expected frame, centre"),
    "epoch": ([MOLNIYA, START, "duration=1h", "epoch=noon"], "epoch: expected an epoch such as"),
    "no epoch": (
        [MOLNIYA, START, "duration=1h", "output=o.oem", "frame=[A,B,UTC]"],
        "expected the date of time zero",
    ),
    "typo": ([MOLNIYA, START, "duraton=1h"], "did you mean 'duration'?"),
    "no model": (
        ["pretrained=molnia", START, "duration=1h"],
        f"pretrained: expected one of {', '.join(names())}; received 'molnia'",
    ),
    "no such key": ([MOLNIYA, START, "duration=1h", "plot=true"], "key 'plot'; --help lists the keys"),
    "deviations": ([MOLNIYA, START, "duration=1h", "start_sd=[1,1,1]"], "start_sd: expected 6 numbers > 0"),
    "no deviation": ([MOLNIYA, START, "duration=1h", "start_sd=[1,0]"], "start_sd: expected"),
    "columns": ([MOLNIYA, "start=other.csv", "duration=1"], "expected positions x, y, z"),
    "alone": ([MOLNIYA, "start=alone.csv", "duration=1"], "received x, y, z only"),
    "units": ([MOLNIYA, "start=angle.csv", "duration=1"], "expected values in km"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_message_and_nothing_is_written(name, here, capsys):
    (here / "other.csv").write_text("t [s],a [km],va [km/s]\n0,1,1\n")
    (here / "alone.csv").write_text("t [s],x [km],y [km],z [km]\n0,1,1,1\n")
    columns = "x [rad],y [rad],z [rad],vx [rad/s],vy [rad/s],vz [rad/s]"
    (here / "angle.csv").write_text(f"t [s],{columns}\n0,1,1,1,1,1,1\n")
    before = sorted(os.listdir(here))
    arguments, message = MISTAKES[name]
    assert call("ahnn.predict", *arguments) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert sorted(os.listdir(here)) == before


def test_runs_of_other_states_do_not_mix(here, cache, capsys):
    small(here / "one", cache)
    assert call("ahnn.predict", "run=[one,molniya_mechanical]", "start=[1,2]", "duration=1") == 2
    assert "expected runs with the same state components" in capsys.readouterr().err


def test_parquet_without_pyarrow_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ahnn.UserError, match=r"ahnn\[parquet\]"):
        packed_table({"a": np.zeros(2)})


def test_help_says_what_there_is(capsys):
    assert call("ahnn.predict", "-h") == 0
    assert "duration=1d" in capsys.readouterr().out
