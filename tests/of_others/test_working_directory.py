"""What lies in the working directory is no library and no plugin; a module that the user names is found."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from entry import call
from foreign import configured

from ahnn.cli.compose import composed
from ahnn.cli.reevaluation import Request, run_config

LIBRARIES = ("signal", "typing", "logging", "yaml", "json", "hydra", "torch", "sitecustomize", "dataclasses")
PLUGINS = ("hydra_plugins/mine", "ahnn_plugins/__init__", "hydra_plugins/ahnn_sweeper/__init__")


@pytest.fixture(scope="module")
def hostile(finished, tmp_path_factory):
    """A run folder with files named as libraries and plugins, which leave a trace when they are imported."""
    folder = Path(shutil.copytree(finished, tmp_path_factory.mktemp("hostile") / "run"))
    for name in (*LIBRARIES, *PLUGINS):
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"open({str(folder.parent / 'trace')!r}, 'a').write({name!r})\n")
    declared = folder / "evil-1.0.dist-info"
    declared.mkdir()
    (declared / "METADATA").write_text("Name: evil\nVersion: 1.0\n")
    (declared / "entry_points.txt").write_text(
        "[ahnn.trusted]\nevil = json\n[ahnn.dynamics]\nevil = json:x\n"
    )
    return folder


COMMANDS = {
    "evaluate": ("run=.", "plugins=none"),
    "predict": ("run=.", "start=[0.5,0]", "duration=0.1"),
    "train": ("--help",),
    "report": ("run=.", "output=../report", "report.figures=false"),
    "reproduce": ("system=none",),
    "data": ("check", "none.csv"),
}


@pytest.mark.parametrize("door", COMMANDS)
@pytest.mark.sampled(3)
def test_nothing_in_the_working_directory_is_imported(hostile, door):
    path = [entry for entry in sys.path if entry and not Path(entry).is_relative_to(hostile)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path)}
    command = [sys.executable, "-m", f"ahnn.{door}", *COMMANDS[door]]
    done = subprocess.run(command, cwd=hostile, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == (2 if door in ("reproduce", "data") else 0), done.stderr
    assert "Traceback" not in done.stderr
    assert not (hostile.parent / "trace").exists()


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The working directory, with a module of one's own; what is imported is forgotten afterwards."""
    source = "from ahnn.systems import MassSpring\n\nclass Mine(MassSpring):\n    pass\n"
    (tmp_path / "module_of_mine.py").write_text(source)
    (tmp_path / "yaml.py").write_text("raise AssertionError\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", str(tmp_path))])
    yield tmp_path
    sys.modules.pop("module_of_mine", None)


def test_a_module_that_the_command_line_names_is_found_behind_all_others(mine):
    composed("train", ["system=mass_spring"])
    composed("train", ["system._target_=yaml.Mine"])
    composed("train", ["system._target_=not_there.Mine"])
    assert str(mine) not in sys.path
    composed("train", ["system._target_=module_of_mine.Mine"])
    assert sys.path.index(str(mine)) == len(sys.path) - 1


def test_one_that_a_run_folder_names_is_found_where_the_user_trusts_it(mine, run, capfd):
    configured(run, "system._target_", "module_of_mine.Mine")
    assert call("ahnn.evaluate", f"run={run}") == 2
    assert "add --trust" in capfd.readouterr().err
    assert str(mine) not in sys.path
    assert "module_of_mine" not in sys.modules
    run_config(run, Request(run, run, "best", None, [], trust=True))
    assert str(mine) in sys.path
    assert yaml.safe_load((run / "config.yaml").read_text())["system"]["_target_"] == "module_of_mine.Mine"
