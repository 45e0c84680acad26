"""A run folder of somebody else: it does not say where is written, and none of its files may be a pipe."""

from __future__ import annotations

import os
import shutil
import socket
import threading
from pathlib import Path

import pytest
import yaml
from entry import call
from foreign import ONE, configured, doors, refused

import ahnn


@pytest.mark.parametrize("name", ["evaluate", "assimilate"])
def test_a_configuration_does_not_say_where_is_written(run, tmp_path, monkeypatch, name):
    theirs = tmp_path / "theirs"
    configured(run, "data.cache", str(theirs))
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path / "mine"))
    command = doors(run, tmp_path)[name]
    fitted = [text for text in command if not text.startswith(("plugins.ukf.process", "start_sd"))]
    assert call(*fitted) == 0  # a filter whose process noise is fitted to data
    assert not theirs.exists()
    assert list((tmp_path / "mine").glob("*.safetensors"))


def test_nor_does_it_by_the_class_of_its_data(run, tmp_path, capfd):
    system = yaml.safe_load((run / "config.yaml").read_text())["system"]
    options = {"trajectories": 20, "seed": 0, "cache": str(tmp_path / "theirs")}
    configured(run, "system", {"_target_": "ahnn.data.sources.Simulated", "system": system, **options})
    refused(doors(run, tmp_path)["evaluate"], capfd, "add --trust")
    configured(run, "system", {"_target_": "ahnn.assimilation.journal.Journal", "path": str(tmp_path / "x")})
    refused(doors(run, tmp_path)["evaluate"], capfd, "add --trust")
    configured(run, "plugins", {"x": {"_target_": "ahnn.training.callbacks.BestPoint", "folder": "x"}})
    refused(doors(run, tmp_path)["evaluate"], capfd, "add --trust")
    assert {path.name for path in tmp_path.iterdir()} == {"run", "lines.csv"}


# Pipes, sockets, devices


def pipe(path):
    os.mkfifo(path)


def sock(path):
    place = Path.cwd()
    os.chdir(path.parent)  # its name may have 100 characters
    try:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(path.name)
    finally:
        os.chdir(place)


ODD = {"pipe": pipe, "socket": sock, "device": lambda path: path.symlink_to("/dev/zero")}
READ = {
    "weights.safetensors": ("predict", "evaluate", "export", "assimilate"),
    "covariance.safetensors": ("predict", "evaluate", "assimilate"),
    "config.yaml": ("evaluate", "assimilate"),
    "metrics.json": ("evaluate",),
}


def ends(command, capfd, said):
    """Assert that a command is refused, from a watchdog that nothing holds up."""
    watchdog = threading.Timer(20, os._exit, [86])
    watchdog.start()
    try:
        refused(command, capfd, said)
    finally:
        watchdog.cancel()


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.parametrize("file", READ)
def test_what_has_no_end_in_place_of_a_file_is_refused(run, tmp_path, capfd, file, kind):
    (run / file).unlink(missing_ok=True)
    ODD[kind](run / file)
    for name in READ[file]:
        ends(doors(run, tmp_path)[name], capfd, file)
    if file == "metrics.json":
        ends(("ahnn.report", str(run), f"output={tmp_path / 'report'}"), capfd, file)


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.sampled(3)
def test_so_is_it_in_place_of_a_file_that_a_command_names(run, tmp_path, capfd, kind):
    for suffix in ("csv", "oem", "yaml", "safetensors", "ckpt", "gfc", "state"):
        ODD[kind](tmp_path / f"odd.{suffix}")
    odd, new = str(tmp_path / "odd"), f"run={tmp_path / 'new'}"
    commands = doors(run, tmp_path)
    for command in (
        ("ahnn.predict", f"run={run}", f"start={odd}.csv", "duration=1"),
        ("ahnn.predict", f"run={run}", f"start={odd}.oem", "duration=1"),
        (*commands["predict"], f"ckpt={odd}.safetensors"),
        (*commands["predict"], f"ckpt={odd}.ckpt"),
        ("ahnn.data.__main__", "check", f"{odd}.csv"),
        (*commands["assimilate"][:3], *commands["assimilate"][4:], f"start={odd}.yaml"),
        (*commands["assimilate"], f"state={odd}.state"),
        ("ahnn.train", "system=files", f"system.path={odd}.csv", new),
        ("ahnn.train", "system=molniya_gravity", f"system.gravity={odd}.gfc", new),
        ("ahnn.train", *ONE, f"ckpt={odd}.ckpt", new),
    ):
        ends(command, capfd, odd)
    assert not (tmp_path / "new").exists()


def test_a_stream_may_come_through_a_pipe(run, tmp_path):
    command = [text for text in doors(run, tmp_path)["assimilate"] if not text.startswith("measurements=")]
    os.mkfifo(tmp_path / "stream")
    writer = threading.Thread(target=lambda: (tmp_path / "stream").write_text("time,q,p\n0.01,0.5,0.0\n"))
    writer.start()
    assert call(*command, f"measurements={tmp_path / 'stream'}") == 0
    writer.join()
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 2


@pytest.mark.slow
def test_a_folder_with_the_name_of_a_number_is_a_run(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("123", "0123", "1e3", "true"):
        shutil.copytree(run, name)
        for named in (f"run={name}", f"run=[{name}]"):
            assert call("ahnn.predict", named, "start=[0.5,0]", "duration=1") == 0
    assert call("ahnn.export", "run=0123", "output=1e37") == 0
    assert Path("1e37", "model.json").is_file()
    assert call("ahnn.report", "run=0123", "output=08", "report.figures=false") == 0
    assert Path("08", "report.html").is_file()
    assert call("ahnn.evaluate", "run=1e3", "name=007") == 0
    assert Path("1e3", "evaluations", "007", "metrics.json").is_file()
    assert call("ahnn.train", *ONE, "run=010", "label=5", "weights=0123") == 0
    assert ahnn.load("010").config["label"] == "5"
