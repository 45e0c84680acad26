"""The command that trains on tasks of the field: what it keeps, what it refuses, what it shows."""

from __future__ import annotations

import json
import math
import re

import pytest
import torch
from entry import call

import ahnn.benchmark
from ahnn.cli import benchmarking, numbered_draws
from ahnn.cli.benchmarking import BenchmarkRequest, DrawnTraining
from ahnn.tasks import TASKS, Draw, FieldTask
from ahnn.types import Space, Trajectories


def drawn(k):
    times = torch.linspace(0, 3, 31, dtype=torch.float64)
    phase = torch.linspace(0, 6, 40, dtype=torch.float64)[:, None] + times + k
    radius = torch.linspace(1.0, 1.7, 40, dtype=torch.float64)[:, None]
    states = torch.stack((radius * phase.cos(), -radius * phase.sin()), dim=-1)
    score = lambda predict: float(predict(states[:3, 0], 4, 0.1).square().sum(-1).sub(1).abs().mean())  # noqa: E731
    return Draw(Trajectories(states, times), Space("spring", ("q", "p")), (0.8, 0.1, 0.1), score)


QUICK = ("model=hnn", "budget=smoke", "evaluation=scores")


@pytest.fixture
def known(monkeypatch):
    task = FieldTask(
        "a spring", "nobody", "|energy error|", "in nothing", {"theirs": 0.5}, {"hnn": QUICK}, drawn
    )
    monkeypatch.setitem(TASKS, "spring", task)
    return task


def finished(folder, task, model, draw, score):
    place = folder / task / model / f"draw_{draw}"
    place.mkdir(parents=True)
    (place / "score.json").write_text(json.dumps({"score": score, "seconds": 3.0}))


def test_a_training_leaves_run_and_score_or_nothing(known, tmp_path, monkeypatch):
    training = DrawnTraining("spring", "hnn", 0, tmp_path / "spring" / "hnn" / "draw_1")
    monkeypatch.setattr(benchmarking, "write_atomically", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        benchmarking.one(training)
    assert not numbered_draws.finished(training)
    assert [path.name for path in training.folder.parent.iterdir()] == []
    monkeypatch.undo()
    monkeypatch.setitem(TASKS, "spring", known)
    benchmarking.one(training)
    assert numbered_draws.finished(training)
    assert 0 <= numbered_draws.score(training)["score"] < 1
    assert (training.folder / "run" / "metrics.json").is_file()
    assert [path.name for path in training.folder.parent.iterdir()] == ["draw_1"]


def test_further_scores_and_floors_are_written_and_a_lost_prediction_is_infinitely_far_off(tmp_path):
    known = drawn(0)._replace(score=lambda _: math.nan, also={"rms": lambda _: 2.0}, floor=lambda: 1e-5)
    found = benchmarking.scored(known, lambda x, *_: x)
    assert found == {"score": math.inf, "rms": 2.0, "floor": 1e-5}
    (tmp_path / "score.json").write_text(json.dumps(found))
    assert numbered_draws.score(DrawnTraining("spring", "hnn", 0, tmp_path)) == found


@pytest.mark.usefixtures("known")
def test_what_is_finished_is_kept_and_shown(tmp_path, capfd, caplog):
    caplog.set_level("INFO", "ahnn")
    for draw, score in ((1, 0.25), (2, 0.75)):
        finished(tmp_path, "spring", "hnn", draw, score)
    assert call("ahnn.benchmark", "spring", "draws=2", f"output={tmp_path}") == 0
    said = capfd.readouterr()
    assert f"2 training runs in {tmp_path}, 2 of them finished" in caplog.text
    assert "0.25 to 0.75" in said.out
    assert "published: theirs 0.5" in said.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "usage: python -m ahnn.benchmark NAME"),
        (["draws=2"], "received no name"),
        (["nowhere"], "benchmark: expected one or more of two_bodies"),
        (["two_bodies", "models=[moon]"], "models: expected one or more of pairs; received moon"),
        (["two_bodies", "draws=0"], "draws"),
        (["two_bodies", "colour=red"], "colour"),
    ],
)
def test_mistakes_are_one_message(words, message, capfd, tmp_path):
    assert call("ahnn.benchmark", *words, *(["output=" + str(tmp_path)] if words else [])) == 2
    error = capfd.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_help_names_every_task():
    assert all(re.search(rf"\b{name}\b", ahnn.benchmark.__doc__) for name in TASKS)


def test_a_place_that_takes_no_folder_is_refused_before_the_work(tmp_path, capfd):
    (tmp_path / "file").touch()
    assert call("ahnn.benchmark", "two_bodies", f"output={tmp_path / 'file'}") == 2
    assert "expected a writable place" in capfd.readouterr().err


@pytest.mark.usefixtures("known")
def test_a_failed_training_is_named_and_the_others_are_shown(tmp_path, monkeypatch, capfd):
    finished(tmp_path, "spring", "hnn", 1, 0.25)
    monkeypatch.setattr(
        benchmarking, "run", lambda plan, _: [t for t in plan if not numbered_draws.finished(t)]
    )
    assert call("ahnn.benchmark", "spring", "draws=2", f"output={tmp_path}") == 3
    said = capfd.readouterr()
    assert "1 of 2 training runs failed, see above: spring/hnn 2" in said.err
    assert "0.25" in said.out


def test_a_child_trains_one_drawing_of_one_model():
    task = TASKS["noisy_spring"]
    asked = BenchmarkRequest(models=["network"], only=3)
    (training,) = benchmarking.trainings({"noisy_spring": task}, asked)
    assert (training.model, training.draw, training.folder.name) == ("network", 2, "draw_3")


@pytest.mark.slow
def test_the_command_trains_in_processes_and_goes_on(tmp_path, capfd):
    words = (
        "ahnn.benchmark",
        "noisy_spring",
        "models=[gaussian_process]",
        "draws=2",
        "jobs=2",
        f"output={tmp_path}",
    )
    assert call(*words) == 0
    first = capfd.readouterr().out
    scores = [json.loads(path.read_text())["score"] for path in tmp_path.glob("*/*/*/score.json")]
    assert len(scores) == 2
    assert all(math.isfinite(score) and score < 1e-2 for score in scores)
    assert call(*words) == 0
    assert capfd.readouterr().out == first
