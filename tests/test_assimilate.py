"""`python -m ahnn.assimilate`: an example, several stations, mistakes, trust, and kills of the process."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
import yaml
from entry import call

import ahnn
from ahnn.data.files import read_oem
from ahnn.measurements import GroundStation

RUN = ahnn.load("molniya_mechanical")
START = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
ORBIT = RUN.rollout(START, 40, 15.0)[0]
NOISE = 0.05 * torch.randn(41, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
FILTER = ["plugins.ukf.process_noise=[1e-3,1e-5]", f"start={START}", "start_sd=[0.1,1e-4]"]
COMMAND = ["pretrained=molniya_mechanical", *FILTER]
BIAS = 0.4
FIXES = ["measurements=fixes.csv", "measurement.sd=0.05"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with position fixes."""
    fixes = (ORBIT[:, :3] + NOISE).tolist()
    rows = ["time,x,y,z", *(f"{15.0 * k},{x},{y},{z}" for k, (x, y, z) in enumerate(fixes))]
    (tmp_path / "fixes.csv").write_text("\n".join(rows[:1] + rows[2:]) + "\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def assimilate(*arguments):
    return call("ahnn.assimilate", *COMMAND, *arguments)


@pytest.mark.usefixtures("place")
def test_fixes_become_estimates_figures_and_an_ephemeris(capsys, caplog):
    made = ["output=out.csv", "state=a.state", "figures=pictures", "oem=out.oem"]
    made += ["frame=EME2000", "center=EARTH", "epoch=2024-03-01T12:00:00"]
    assert assimilate(*FIXES, *made, "plugins.ukf.gate=0.9999", "--watch") == 0
    assert "40 taken" in capsys.readouterr().err
    (orbit,) = read_oem("out.oem")
    error = torch.from_numpy(orbit.states[-1].copy()) - ORBIT[-1]
    sd = torch.from_numpy(orbit.covariances[-1].matrix.copy()).diagonal().sqrt()
    assert bool((error.abs() < 4 * sd).all())
    assert float(sd[:3].max()) < 0.05
    assert len({*Path("pictures").glob("*.png")}) == 3
    before = Path("out.csv").read_bytes()
    assert assimilate(*FIXES, *made, "plugins.ukf.gate=0.9999") == 0
    assert "resuming after line 41" in caplog.messages
    assert Path("out.csv").read_bytes() == before


@pytest.mark.usefixtures("place")
def test_several_stations_speak_in_one_stream_and_the_bias_of_one_is_found(caplog):
    sites = {"kiruna": (67.86, 20.96), "troll": (-72.0, 2.5)}
    stations = {name: GroundStation(*site, range_rate=True) for name, site in sites.items()}
    lines = []
    for k in range(1, 41):
        name = [*sites][k % 2]
        model, t = stations[name], 15.0 * k
        seen = zip(model.names, model(ORBIT[k], t).tolist(), strict=True)
        late = {"kiruna": BIAS, "troll": 0.0}[name]
        told = {key: value + late * (key == "range") for key, value in seen}
        lines.append(json.dumps({"time": t, "sensor": name, **told}))
    Path("seen.jsonl").write_text("\n".join(lines))
    named = [f"+measurement@sensors.{name}=ground_station" for name in sites]
    named += [f"sensors.{name}.model.latitude={site[0]}" for name, site in sites.items()]
    named += [f"sensors.{name}.model.longitude={site[1]}" for name, site in sites.items()]
    named.append("sensors.kiruna.bias_sd=[1,0,0,0]")
    assert assimilate("measurements=seen.jsonl", *named, "output=out.jsonl") == 0
    (told,) = (line for line in caplog.messages if line.startswith("bias of"))
    found = re.fullmatch(r"bias of kiruna: range (\S+) ± (\S+) km", told)
    assert found is not None
    assert abs(float(found[1]) - BIAS) < 3 * float(found[2]) < 0.3
    rows = [json.loads(line) for line in Path("out.jsonl").read_text().splitlines()]
    assert [row["outcome"] for row in rows] == ["taken"] * 40
    names = ("x", "y", "z", "vx", "vy", "vz")
    error = torch.tensor([rows[-1][name] for name in names], dtype=torch.float64) - ORBIT[-1]
    assert float(error[:3].norm()) < 0.05
    assert rows[0]["innovation_range"] is not None


MISTAKES = {
    "": "measurements: expected a file of measurements, or - for standard input; received none. Add meas",
    "measurement=fixes.csv": "received none. Add measurements=FILE; measurement= chooses the sensor",
    "measurements=none.csv": "file none.csv: No such file",
    "measurements=fixes.csv wndow=3": "unknown key 'wndow'; did you mean 'window'?",
    "measurements=fixes.csv window=-1": "window: expected float >= 0; received -1",
    "measurements=fixes.csv every=0": "every: expected int >= 1 or None; received 0",
    "measurements=fixes.csv oem=x.oem": "output: expected a FILE",
    "measurements=fixes.csv output=fixes.csv": "output: expected a new file",
    "measurements=fixes.csv start=[1,2]": "start: expected one or more states [x [km], y",
    "measurements=fixes.csv start_sd=[1,2,3]": "start_sd: expected 6 numbers > 0",
    "measurements=fixes.csv measurement.sd=[1,2]": "expected a standard deviation > 0 for each of x [km], y",
    "measurements=fixes.csv measurement=ground_station": "expected a header with time and range, az",
    "measurements=fixes.csv measurement=ground_station measurement.model.mass=2": "expected mass=1",
    "measurements=fixes.csv plugins.ukf.bias_sd=1": "define it (measurement.bias_sd)",
    "measurements=fixes.csv measurement.bias_sd=a": "bias_sd: expected standard deviations of biases",
    "measurements=fixes.csv measurement.bias_sd=[[1]]": "bias_sd: expected standard deviations of biases",
    "measurements=fixes.csv +measurement@sensors.a=position measurement.bias_sd=1": "defines what each sen",
    "measurements=fixes.csv system.dt=3 trainer.max_epochs=3": "unknown key 'trainer'",
}


@pytest.mark.parametrize("words", MISTAKES, ids=str)
def test_a_mistake_is_one_message_and_leaves_nothing(place, capsys, words):
    assert assimilate(*words.split()) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert MISTAKES[words] in lines[0]
    assert [path.name for path in place.iterdir()] == ["fixes.csv"]


@pytest.mark.usefixtures("place")
def test_what_does_not_filter_online_is_refused(capsys):
    assert call("ahnn.assimilate", "pretrained=molniya_mechanical", FIXES[0], FILTER[1], "plugins=none") == 2
    assert "plugins: expected one that filters online, such as plugins=ukf" in capsys.readouterr().err


@pytest.mark.usefixtures("place")
def test_a_gate_is_on_by_default_and_opens_again_for_a_filter_that_is_lost(capsys, caplog):
    caplog.set_level("INFO", "ahnn")
    lost, ten = "start=[200,-3145,-6173,10,0,0]", ["rejected"] * 9 + ["reopened"]
    options = {
        "": ["rejected"] * 4 + ["reopened"],
        "plugins.ukf.patience=10": ten,
        "gate=0.99": ["rejected"] * 4 + ["reopened"],
        "gate=none": ["taken"] * 5,
    }
    for option, outcomes in options.items():
        assert assimilate(*FIXES, lost, *([option] if option else []), "output=track.csv") == 0
        with Path("track.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        Path("track.csv").unlink()
        assert [row["outcome"] for row in rows[: len(outcomes)]] == outcomes
        ends = [float(rows[-1][name]) - ORBIT[40, k] for k, name in enumerate(("x", "y", "z"))]
        assert (max(map(abs, ends)) < 0.2) == (option != "gate=none")
    assert "reopened the gate after consecutive rejections; the covariance was enlarged" in caplog.text
    assert "reopened once after too many consecutive rejections" in caplog.text
    assert "start: all 4 measurements before this one were rejected" in caplog.text
    assert assimilate(*FIXES, "gate=2", "output=track.csv") == 2
    assert "gate: expected" in capsys.readouterr().err


def test_a_run_folder_that_names_a_callable_is_refused(place, capsys):
    folder = Path(shutil.copytree(RUN.folder, place / "run"))
    content = yaml.safe_load((folder / "config.yaml").read_text())
    content["plugins"] = {"ukf": {"_target_": "os.system", "command": f"touch {place / 'trace'}"}}
    (folder / "config.yaml").write_text(yaml.safe_dump(content))
    assert call("ahnn.assimilate", f"run={folder}", *FIXES, FILTER[1]) == 2
    assert "os.system" in capsys.readouterr().err
    assert not (place / "trace").exists()


def test_help_says_what_there_is(capsys):
    assert call("ahnn.assimilate", "--help") == 0
    text = capsys.readouterr().out
    assert "state=FILE" in text
    assert max(map(len, text.splitlines())) <= 110


def started(place, **options):
    command = [sys.executable, "-m", "ahnn.assimilate", *COMMAND, "measurement.sd=0.05", "every=7"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    arguments = ["measurements=-", "output=out.csv", "state=a.state"]
    return subprocess.Popen([*command, *arguments], cwd=place, env=environment, **options)


def wait_until_it_has(rows, path):
    end = time.monotonic() + 120
    while not path.exists() or len(path.read_text().splitlines()) != rows:
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
def test_a_pipe_is_answered_line_by_line_and_a_killed_process_goes_on(place):
    lines = Path("fixes.csv").read_text().splitlines(keepends=True)
    sent, out = 0, place / "out.csv"
    for until in (11, 25, len(lines)):
        process = started(place, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for line in lines[sent:until]:
            process.stdin.write(line)
            process.stdin.flush()
            sent += 1
            wait_until_it_has(sent, out)  # the answer to a line comes before the next one is there
        if until < len(lines):
            process.send_signal(signal.SIGKILL)
        process.communicate()
    assert process.returncode == 0
    assert assimilate(*FIXES, "output=whole.csv") == 0
    assert out.read_bytes() == Path("whole.csv").read_bytes()
    assert not (place / "a.state.lines").read_bytes().partition(b"\n")[2]


@pytest.mark.usefixtures("place")
def test_beyond_the_training_data_the_novelty_widens_what_is_known(caplog):
    far = [0.0, -4200.0, -8240.0, 8.6, 0.0, 0.0]
    assert float(RUN.novelty(far)) > 1.5
    fixes = RUN.rollout(far, 40, 15.0)[0, 1:, :3].tolist()
    rows = [f"{15.0 * (k + 1)},{x},{y},{z}" for k, (x, y, z) in enumerate(fixes)]
    Path("fixes.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    noise = "plugins.ukf.process_noise={size: 4.8e-6, memory: 1918}"
    options = [*FIXES, "pretrained=molniya_mechanical", f"start={far}", "start_sd=[0.1,1e-4]", noise]
    known = []
    for name, more in (("plain.csv", []), ("wide.csv", ["plugins.ukf.novelty=500"])):
        assert call("ahnn.assimilate", *options, *more, f"output={name}") == 0
        *_, last = csv.DictReader(Path(name).read_text().splitlines())
        known.append(float(last["cov_vx_vx"]))
    assert known[1] > 10 * known[0]
    assert [said.split(",")[0] for said in caplog.messages if said.startswith("novelty")] == [
        "novelty: the last estimate lies beyond the training data"
    ] * 2


@pytest.mark.usefixtures("place")
def test_epochs_of_a_stream_are_times_from_its_zero():
    numbers = Path("fixes.csv").read_text().splitlines()
    epochs = [f"2024-03-01T12:{k // 4:02}:{15 * (k % 4):02},{row.partition(',')[2]}"
              for k, row in enumerate(numbers[1:], 1)]  # fmt: skip
    Path("dated.csv").write_text("\n".join([numbers[0], *epochs]) + "\n")
    assert assimilate(*FIXES, "output=numbers.out") == 0
    dated = ["measurements=dated.csv", "measurement.sd=0.05", "epoch=2024-03-01T12:00:00", "output=dated.out"]
    assert assimilate(*dated) == 0
    head, *given = Path("dated.out").read_text().splitlines()
    assert head.split(",")[2] == "epoch"
    assert given[-1].split(",")[2] == "2024-03-01T12:10:00.000"
    without = [",".join([*line.split(",")[:2], *line.split(",")[3:]]) for line in (head, *given)]
    assert without == Path("numbers.out").read_text().splitlines()
    kept = [*dated[:-1], "output=kept.out", "state=kept.state"]
    assert assimilate(*kept) == 0
    assert assimilate(*kept, "epoch=2024-03-02T12:00:00") == 2


@pytest.mark.usefixtures("place")
def test_lines_sent_again_after_the_end_of_a_stream_have_no_effect(place, monkeypatch):
    """Two outliers: rejected and late lines would be more than those that the filter has followed."""
    lines = Path("fixes.csv").read_text().splitlines()
    for k in (10, 20):
        lines[k] = lines[k].partition(",")[0] + ",9000,9000,9000"
    Path("fixes.csv").write_text("\n".join(lines) + "\n")
    again = ["measurements=-", "measurement.sd=0.05", "output=out.csv"]
    for _ in range(2):
        with Path("fixes.csv").open() as lines:
            monkeypatch.setattr(sys, "stdin", lines)
            assert assimilate(*again, "state=a.state", "every=7") == 0
        found = (place / "out.csv").read_bytes()
    assert assimilate(*FIXES, "output=whole.csv") == 0
    assert found == (place / "whole.csv").read_bytes()
