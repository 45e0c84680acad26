"""`python -m ahnn.assimilate` of a model with controls: columns, a file, numbers, stops, and mistakes."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from entry import SMALL, call
from helpers import close

import ahnn

CONF = Path(__file__).parent / "motions" / "conf"
DOUBLE = {"dtype": torch.float64}
TIMES = torch.tensor([0.0, 0.1, 0.13, 0.2, 0.3, 0.4], **DOUBLE)
PUSHES = [1.0, 1.0, -2.0, -2.0, 0.5, 0.5]
FIXES = "time,q,u\n0,,1\n0.1,0.11,\n0.13,,-2\n0.2,0.12,\n0.3,0.13,0.5\n0.4,,\n"
CHANGES = "t [ms],command\n0,1\n130,-2\n300,0.5\n"


@pytest.fixture(scope="module")
def spring(tmp_path_factory):
    """A run that learned, badly, how a spring is pushed."""
    folder = tmp_path_factory.mktemp("runs") / "pushed"
    options = ["system=pushed_spring", "hamiltonian=mechanical", "forces=controls", "loss=recursive"]
    options += ["recipe=second_order", "evaluation=scores", "data.batch_size=100", "trainer.max_epochs=1"]
    assert call("ahnn.train", "--config-dir", str(CONF), f"run={folder}", *SMALL, *options) == 0
    return folder


@pytest.fixture
def words(spring, tmp_path, monkeypatch):
    """A command, in a folder with its stream."""
    monkeypatch.chdir(tmp_path)
    Path("fixes.csv").write_text(FIXES)
    Path("pushes.csv").write_text(CHANGES)
    rows = [line.rpartition(",")[0] for line in FIXES.splitlines()]
    Path("alone.csv").write_text("\n".join(row for row in rows if row != "0.13,") + "\n")
    options = ["start=[0.1,0]", "start_sd=[0.1,0.1]", "measurement.sd=0.01", "output=out.csv"]
    return ["ahnn.assimilate", f"run={spring}", "--trust", "plugins.ukf.process_noise=[1e-4,1e-4]", *options]


def rows(path="out.csv"):
    return list(csv.DictReader(Path(path).read_text().splitlines()))


def numbers(found):
    return [{k: v for k, v in row.items() if k != "line"} for row in found]


def test_columns_and_a_file_of_controls_give_the_same_estimates(words, caplog):
    assert call(*words, "measurements=fixes.csv") == 0
    ahead = ["measurements=alone.csv", "controls=pushes.csv", "output=ahead.csv"]
    assert call(*words, *ahead) == 0
    assert numbers(row for row in rows() if row["time"] != "0.13") == numbers(rows("ahead.csv"))
    assert "controls: the last values of pushes.csv, at 0.3, are held until the end, at 0.4" in caplog.text
    assert "2 predicted, 3 taken" in caplog.text


def test_where_nothing_is_measured_the_estimate_is_the_prediction(words, spring):
    blind = [f"{line.partition(',')[0]},{line.rpartition(',')[2]}" for line in FIXES.splitlines()[1:]]
    Path("blind.csv").write_text("\n".join(["time,u", *blind]) + "\n")
    exact = ["start_sd=[1e-6,1e-6]", "plugins.ukf.process_noise=[1e-8,1e-8]"]
    assert call(*words, *exact, "measurements=blind.csv") == 0
    told = ahnn.load(spring).predict([0.1, 0.0], TIMES, controls=torch.tensor(PUSHES, **DOUBLE)[:, None])
    found = torch.tensor([[float(row["q"]), float(row["vq"])] for row in rows()], **DOUBLE)
    close(found, told.states[0], 1e-9)


def test_a_stream_goes_on_under_the_controls_that_hold(words):
    assert call(*words, "measurements=fixes.csv") == 0
    lines = Path("fixes.csv").read_text().splitlines(keepends=True)
    for count in (3, 4, 5, len(lines)):
        Path("fixes.csv").write_text("".join(lines[:count]))
        assert call(*words, "measurements=fixes.csv", "output=parts.csv", "state=a.state", "every=1") == 0
    assert Path("parts.csv").read_bytes() == Path("out.csv").read_bytes()


def test_numbers_are_held_all_the_time(words):
    assert call(*words, "measurements=alone.csv", "controls=[0.7]") == 0
    Path("held.csv").write_text("t,u\n0,0.7\n")
    assert call(*words, "measurements=alone.csv", "controls=held.csv", "output=held.out") == 0
    assert Path("held.out").read_text() == Path("out.csv").read_text()


MISTAKES = {
    "measurements=alone.csv": "controls: expected values at the start, time 0; received none before",
    "measurements=fixes.csv controls=pushes.csv": "expected controls either in a table or in readings",
    "measurements=alone.csv controls=none.csv": "controls: expected numbers or a file; received none.csv: No",
    "measurements=alone.csv controls=[1,2]": "controls: expected a FILE with time and u, or constant numbers",
    "measurements=alone.csv controls=[a]": "controls: ",
    "measurements=alone.csv controls=pushes.csv time=-1": "expected values at the start, time -1; received",
    "measurements=alone.csv controls=fixes.csv": "column u: expected a number in each row; received none",
}


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_with_controls_is_one_message_and_leaves_nothing(mistake, words, capsys, tmp_path):
    there = {path.name for path in tmp_path.iterdir()}
    assert call(*words, "state=a.state", *mistake.split()) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert MISTAKES[mistake] in lines[0]
    if mistake != "measurements=alone.csv":  # whose first line needs no controls, at the start
        assert {path.name for path in tmp_path.iterdir()} == there


def test_a_model_without_controls_takes_none_in_a_stream(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("fixes.csv").write_text("time,x,y,z,u\n15,1,2,3,4\n")
    words = [
        "ahnn.assimilate",
        "pretrained=molniya_mechanical",
        "measurements=fixes.csv",
        "start_sd=[0.1,1e-4]",
    ]
    words += ["start=[0,-3145,-6173,10,0,0]", "measurement.sd=1", "plugins.ukf.process_noise=[1e-3,1e-5]"]
    assert call(*words, "controls=[1]") == 2
    assert "controls: expected none for molniya_mechanical, whose forces take none" in capsys.readouterr().err
    assert call(*words) == 2
    assert "expected a header with time and x, y, z; received 'u'" in capsys.readouterr().err
