"""The campaign of faults in small, and kills during writes, on a disk and in memory."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from entry import untouched

CAMPAIGN = Path(__file__).parent / "campaign"


def test_no_case_of_a_small_campaign_fails(monkeypatch, capsys):
    monkeypatch.setenv("PYTHONUNBUFFERED", "")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "argv", ["run.py", "--seed", "1", "--cases", "6"])
    with untouched():
        failed = runpy.run_path(str(CAMPAIGN / "run.py"), run_name="campaign")["main"]()
    said = capsys.readouterr().out
    assert failed == 0, said
    assert said.splitlines()[-1].startswith("all")


@pytest.mark.slow
def test_no_case_of_a_campaign_fails():
    words = [sys.executable, str(CAMPAIGN / "run.py"), "--seed", "1", "--cases", "1500"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("all")


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("place", ["disk", "/dev/shm"])
@pytest.mark.parametrize("kills", [8, pytest.param(100, marks=pytest.mark.slow)])
def test_a_kill_during_a_write_loses_no_checkpoint_and_leaves_nothing(tmp_path, monkeypatch, kills, place):
    monkeypatch.syspath_prepend(CAMPAIGN)
    from families.kills import checkpoint

    draw = torch.Generator().manual_seed(kills)
    for _ in range(kills):
        checkpoint(tmp_path if place == "disk" else Path(place), float(torch.rand((), generator=draw)))
