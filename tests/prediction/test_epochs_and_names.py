"""First epoch, and identifier and name of the object, from file to file through all commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from entry import call
from helpers import framed
from made_orbits import OMM
from test_starts_from_files import MOLNIYA, NOON, SHORT, STATE, P, first, here, message

import ahnn
from ahnn.assimilation.assimilation_record import AssimilationRecord
from ahnn.data.files import Covariance, Ephemeris, read_oem, write_oem
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.jobs.assimilating import estimated
from ahnn.prediction.figure import prediction_figure
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space, Units

__all__ = ["here"]
QUIET = "plugins.ukf.process_noise=[1e-6,1e-9]"
"""A fixed process noise, since a fit of it to validation data takes seconds."""


def test_the_line_of_a_prediction_names_its_first_epoch_and_what_is_not_stated(capsys):
    """Also in the figure; the times of an assimilation count from the time zero of its model."""
    assert call("ahnn.predict", MOLNIYA, message(), *SHORT) == 0
    assert "\nEME2000, EARTH, UTC, from 2024-03-01T12:00:00.000\n" in capsys.readouterr().out
    numbers = [f"start={STATE.tolist()}", "epoch=2024-03-01T12:00:00", *SHORT]
    assert call("ahnn.predict", MOLNIYA, *numbers) == 0
    said = "\nUTC, frame and centre not stated (frame=), from 2024-03-01T12:00:00.000\n"
    assert said in capsys.readouterr().out
    run = framed(Path("run"), "EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000")
    Path("fixes.csv").write_text("t,x,y,z\n1200,0,-3145,-6173\n")
    begun = [f"start={STATE.tolist()}", "start_sd=[1,0.001]", "time=1200", "measurements=fixes.csv"]
    sensor = ["+sensors.fix.model=position", "+sensors.fix.sd=[1]", QUIET]
    files = ["output=track.csv", "oem=track.oem", "figures=pictures"]
    assert call("ahnn.assimilate", f"run={run}", *begun, *sensor, *files) == 0
    capsys.readouterr()
    for start in ("track.csv", "track.oem"):
        assert call("ahnn.predict", f"run={run}", f"start={start}", *SHORT, "figure=ahead.svg") == 0
        said = "EME2000, EARTH, UTC, from 2024-03-01T12:20:00.000"
        zero = " (time zero 2024-03-01T12:00:00.000)" if start == "track.csv" else ""
        assert f"\n{said}{zero}\n" in capsys.readouterr().out
        drawn = Path("ahead.svg").read_text()
        assert f"{said} -->" in drawn
        assert zero.strip() in drawn  # on a line of its own, since titles are narrow
    drawn = Path("pictures/innovations.svg").read_text()
    assert "EME2000, EARTH, UTC, time zero 2024-03-01T12:00:00.000" in drawn


def test_identifier_and_name_of_an_object_pass_from_file_to_file():
    """From a message to a prediction, to a track and its message, and on from each of them."""
    known = (Covariance(0.0, P, "EME2000"),)
    about = "2026-001A", "MYGTO", "EARTH", "EME2000", "UTC", NOON
    write_oem("start.oem", [Ephemeris(*about, np.zeros(1), STATE[None], known)])
    run = f"run={framed(Path('run'), 'EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000')}"
    Path("fixes.csv").write_text("t,x,y,z\n600,0,-3145,-6173\n")
    stream = [run, "measurements=fixes.csv", "+sensors.fix.model=position", "+sensors.fix.sd=[1e4]", QUIET]
    for k, (start, more, name) in enumerate(
        (("start.oem", [], "MYGTO"), ("start.oem", ["object=OTHER"], "OTHER"), ("numbers", ["object=X"], "X"))
    ):
        begun = [f"start={start}"] if k < 2 else [f"start={STATE.tolist()}", "start_sd=[1,0.001]", "time=0"]
        files = [f"output=track{k}.csv", f"oem=track{k}.oem"]
        assert call("ahnn.assimilate", *stream, *begun, *more, *files) == 0
        ident = "2026-001A" if k < 2 else "X"
        (found,) = read_oem(f"track{k}.oem")
        assert (found.object_id, found.object_name) == (ident, name)
        assert f"objects:\n  {ident}: {name}\n" in Path(f"track{k}.yaml").read_text()
        for start in (f"track{k}.csv", f"track{k}.oem"):
            assert call("ahnn.predict", run, f"start={start}", *SHORT, "output=ahead.csv") == 0
            assert first("ahead.csv")["id"] == ident
            assert call("ahnn.predict", run, "start=ahead.csv", *SHORT, "output=again.oem") == 0
            (found,) = read_oem("again.oem")
            assert (found.object_id, found.object_name) == (ident, name)


def test_the_epoch_of_a_frame_of_date_has_its_own_keyword_in_the_message_of_a_stream():
    """And states in other units than km, km/s and s are converted to them."""
    moment, units = "2026-03-01T00:00:00.000", Units("min", "m", "m/s", "J")
    space = Space("orbit", tuple("xyzabc"), units, inertia=2.0)
    states, covariance = STATE * np.array([[1.0], [2.0]]), np.stack([P, 4 * P])
    none = np.zeros(2)
    found = np.array([3.0, 5.0]), states, covariance
    record = AssimilationRecord(*found, none.astype(str), none, none, (), none, none, none.astype(str))
    about = Reference.of(f"CIRS of {moment}, EARTH, UTC, from {moment}")
    write_oem("track.oem", estimated(record, ObjectName("7", "", "2026-001A"), space, about))
    assert f"REF_FRAME = CIRS\nREF_FRAME_EPOCH = {moment}\n" in Path("track.oem").read_text()
    (found,) = read_oem("track.oem")
    assert (found.object_id, found.object_name) == ("2026-001A", "7")
    assert (found.epoch(0.0), found.times.tolist()) == ("2026-03-01T00:03:00.000", [0.0, 120.0])
    scale = np.array([1e-3] * 3 + [5e-4] * 3)
    assert np.allclose(found.states, states * scale, rtol=1e-14, atol=0)
    assert np.allclose(found.covariances[1].matrix, 4 * P * scale * scale[:, None], rtol=1e-14, atol=0)


def test_an_object_without_a_name_is_unknown_and_each_of_several_has_a_message():
    dated = [MOLNIYA, "epoch=2024-03-01T12:00:00", "frame=[EME2000,EARTH,UTC]", *SHORT, "output=ahead.oem"]
    assert call("ahnn.predict", *[word.replace(",UTC", ",MOONTIME") for word in dated]) == 2
    assert not Path("ahead.oem").exists()
    one, two = STATE.tolist(), [STATE.tolist()] * 2
    assert call("ahnn.predict", *dated, f"start={one}") == 0
    (found,) = read_oem("ahead.oem")
    assert (found.object_id, found.object_name) == ("UNKNOWN", "UNKNOWN")
    Path("ahead_2.oem").write_text("mine")
    assert call("ahnn.predict", *dated, f"start={two}") == 2
    assert Path("ahead_2.oem").read_text() == "mine"
    assert not Path("ahead_1.oem").exists()
    Path("ahead_2.oem").unlink()
    assert call("ahnn.predict", *dated, f"start={two}") == 0
    assert [(one.object_id, one.object_name) for one in read_oem("ahead_2.oem")] == [("2", "2")]
    read = pytest.importorskip("oem", reason="another reader of messages").OrbitEphemerisMessage
    assert [segment.metadata["OBJECT_ID"] for segment in read.open("ahead_1.oem").segments] == ["1"]


@pytest.mark.parametrize(
    ("span", "unit", "last"), [(7200.0, "s", 7200.0), (86400.0, "h", 24.0), (1728e3, "d", 20.0)]
)
def test_the_time_axis_of_a_prediction_has_hours_for_long_spans_as_that_of_a_stream(span, unit, last):
    times = torch.linspace(0, span, 5, dtype=torch.float64)
    prediction = Prediction(times, torch.zeros(1, 5, 6, dtype=torch.float64))
    space = ahnn.load("molniya_mechanical").space
    axes = prediction_figure(prediction, space, "ahead").axes
    assert axes[-1].get_xlabel() == f"time after the start [{unit}]"
    assert axes[-1].get_xlim() == (0, last)
    assert axes[0].lines[0].get_xdata()[-1] == last


def test_standard_deviations_have_a_panel_of_their_own():
    """Their values in the units of the table; those of an exact component are left out."""
    times, space = torch.arange(3, dtype=torch.float64), ahnn.load("molniya_mechanical").space
    sd = torch.tensor([0.0, 0.1, 20.0], dtype=torch.float64)
    covariances = (sd[:, None] ** 2 * torch.ones(6, dtype=torch.float64) * space.scales**2).diag_embed()[None]
    figure = prediction_figure(Prediction(times, torch.zeros(1, 3, 6).double(), covariances), space, "ahead")
    panel = figure.axes[2]
    assert (len(figure.axes), panel.get_yscale()) == (3, "log")
    assert panel.get_ylabel() == "standard deviation\n[km]"
    for line in panel.lines:
        assert line.get_ydata()[1:] == pytest.approx([0.1, 20.0])
        assert line.get_ydata()[0] != line.get_ydata()[0]


def test_weights_of_an_interrupted_training_are_called_preliminary(caplog):
    """By each command that uses them, with the way to resume; the sidecar of a prediction says so too."""
    run = framed(Path("run"), "EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000")
    asked = [f"run={run}", f"start={STATE.tolist()}", *SHORT, "output=ahead.csv"]
    Path("fixes.csv").write_text("t,x,y,z\n600,0,-3145,-6173\n")
    stream = [asked[0], "measurements=fixes.csv", "+sensors.fix.model=position", "+sensors.fix.sd=[1e4]"]
    stream += [asked[1], "start_sd=[1,0.001]", "time=0", QUIET]
    said = "run run: the training was not finished"
    for k, unfinished in enumerate((False, True)):
        if unfinished:
            (run / "metrics.json").unlink(missing_ok=True)
            (run / "checkpoints").mkdir()
            (run / "checkpoints" / "last.ckpt").touch()
        caplog.clear()
        assert call("ahnn.predict", *asked) == 0
        assert (said in caplog.text) == unfinished
        assert ("Resume it: repeat its command with run=run ckpt=last" in caplog.text) == unfinished
        assert ("the training was not finished" in Path("ahead.yaml").read_text()) == unfinished
        caplog.clear()
        assert call("ahnn.assimilate", *stream, f"output=track{k}.csv") == 0
        assert (said in caplog.text) == unfinished
    (run / "metrics.json").touch()
    caplog.clear()
    assert call("ahnn.predict", *asked) == 0
    assert said not in caplog.text


def test_a_start_of_several_states_says_which_one_it_is(caplog):
    """A prediction begins at the first state of a file, or at the last estimate of a track."""
    caplog.set_level("INFO", "ahnn")
    assert call("ahnn.predict", MOLNIYA, message(), "duration=3min", "step=1min", "output=ahead.oem") == 0
    assert not [text for text in caplog.messages if text.startswith("start start.oem: the first")]
    Path("plain.csv").write_text("t [min],x,y,z,vx,vy,vz\n2,0,-3145,-6173,10,0,0\n3,9,-3145,-6173,10,0,0\n")
    Path("plain.yaml").write_text("units: {x: km, y: km, z: km, vx: km/s, vy: km/s, vz: km/s}\n")
    Path("fixes.csv").write_text("t,x,y,z\n60,0,-3145,-6173\n120,0,-3145,-6173\n")
    begun = [
        "measurements=fixes.csv",
        "+sensors.fix.model=position",
        "+sensors.fix.sd=[1e4]",
        QUIET,
        "start=ahead.oem",
    ]
    assert call("ahnn.assimilate", MOLNIYA, *begun, "start_sd=[1,0.001]", "time=0", "output=track.csv") == 0
    assert "start ahead.oem: the last of 4 states, 2024-03-01T12:03:00.000" in caplog.messages
    for start, words in (
        ("ahead.oem", "the first of 4 states, 2024-03-01T12:00:00.000"),
        ("plain.csv", "the first of 2 states, t = 120 s"),
        ("track.csv", "the last estimate, 2024-03-01T12:05:00.000"),
    ):
        assert call("ahnn.predict", MOLNIYA, f"start={start}", *SHORT) == 0
        assert f"start {start}: {words}" in caplog.messages


def test_name_and_international_designator_of_mean_elements_reach_the_messages():
    """The catalogue number remains the identifier in tables."""
    pytest.importorskip("sgp4.api", reason="the extra `orbit` is needed")
    lines = [
        "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753",
        "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667",
    ]
    Path("a.tle").write_text("\n".join(["0 VANGUARD 1", *lines]) + "\n")
    Path("b.json").write_text(json.dumps(OMM))
    Path("fixes.csv").write_text("t,x,y,z\n2000-06-27T18:51:19,7000,0,0\n")
    stream = ["measurements=fixes.csv", "+sensors.fix.model=position", "+sensors.fix.sd=[1e4]", QUIET]
    stream += ["start_sd=[1e4,10]", "plugins.ukf.process_noise=[1e-3,1e-5]"]
    for start, name in (("a.tle", "00005"), ("b.json", "5")):
        assert call("ahnn.predict", MOLNIYA, f"start={start}", *SHORT, "output=out.oem") == 0
        begun = [f"start={start}", f"output={name}.csv", f"oem={name}.oem"]
        assert call("ahnn.assimilate", MOLNIYA, *stream, *begun) == 0
        for file in ("out.oem", f"{name}.oem"):
            (found,) = read_oem(file)
            assert (found.object_name, found.object_id) == ("VANGUARD 1", "1958-002B")
        assert call("ahnn.predict", MOLNIYA, f"start={start}", *SHORT, "output=out.csv") == 0
        assert yaml.safe_load(Path("out.yaml").read_text())["objects"] == {name: "VANGUARD 1"}
